"""Makes functions written for a batch on the last axis usable under any `vmap`.

A CPU fills its vector registers along the last axis; `vmap` alone would put the batch first.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def single_from_batch(function: Callable[..., Any]) -> Callable[..., Any]:
    """Makes a function of one element from a function of a batch.

    Under `vmap`, nested ones too, all batch axes become one last axis of `function`'s arguments.

    Args:
        function: takes and returns pytrees of arrays whose last axis is the batch.

    Returns:
        The same function, of arrays without that axis.
    """

    @jax.custom_batching.custom_vmap
    def batched(*args: Any) -> Any:
        return function(*args)

    @batched.def_vmap
    def rule(axis_size: int, is_batched: list[Any], *args: Any) -> tuple[Any, Any]:
        def merge(leaf: jax.Array, has_axis: bool) -> jax.Array:
            if not has_axis:
                leaf = jnp.broadcast_to(leaf, (axis_size, *leaf.shape))
            return jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], -1)

        def part(leaf: jax.Array) -> jax.Array:
            split = leaf.reshape(*leaf.shape[:-1], axis_size, -1)
            return jnp.moveaxis(split, -2, 0)

        out = jax.tree.map(part, batched(*jax.tree.map(merge, args, tuple(is_batched))))
        return out, jax.tree.map(lambda _: True, out)

    def one(*args: Any) -> Any:
        columns = jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], args)
        return jax.tree.map(lambda leaf: leaf[..., 0], batched(*columns))

    return one
