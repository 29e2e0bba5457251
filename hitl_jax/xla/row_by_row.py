"""Rows that do not know how many others there are.

XLA multiplies a batch of rows with weights that they share as one product, and rounds a row's sums
by the number of the rows and by its place among them. What a person's network tells of one walker
would then depend on the walkers beside it.
"""

import functools
from collections.abc import Callable
from typing import Any

import chex
import jax

from hitl_jax.types import Params

Apply = Callable[[Params, chex.Array], chex.Array]
"""Maps parameters and one row [O] to an array."""


def row_by_row(apply: Apply) -> Apply:
    """The same function, which in a batch of any size gives the same to the last bit on a CPU.

    Rows that share their parameters are a loop there; on an accelerator they are one product, as
    usual.

    Args:
        apply: maps parameters, any pytree of arrays, and one row [O] to an array.

    Returns:
        The function, to be used under `jit`, `vmap` and `grad` as `apply` is.
    """

    @jax.custom_batching.custom_vmap
    def alone(params: Params, row: chex.Array) -> chex.Array:
        return apply(params, row)

    @alone.def_vmap
    def _(
        axis_size: int, batched: list[Any], params: Params, row: chex.Array
    ) -> tuple[chex.Array, Any]:
        del axis_size
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched)
        together = jax.vmap(apply, in_axes=axes)
        if any(jax.tree.leaves(batched[0])):
            result = together(params, row)
        else:
            result = jax.lax.platform_dependent(
                params,
                row,
                cpu=lambda params, rows: jax.lax.map(functools.partial(alone, params), rows),
                default=together,
            )
        return result, jax.tree.map(lambda _: True, result)

    @jax.custom_jvp
    def differentiable(params: Params, row: chex.Array) -> chex.Array:
        result: chex.Array = alone(params, row)
        return result

    @differentiable.defjvp
    def _(primals: Any, tangents: Any) -> tuple[chex.Array, chex.Array]:
        return differentiable(*primals), jax.jvp(apply, primals, tangents)[1]

    return differentiable
