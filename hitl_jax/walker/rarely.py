"""Work that only few of a batch need."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from hitl_jax.walker import gpu
from hitl_jax.walker.gpu.kernel import as_kernel

Tree = TypeVar("Tree")
Other = TypeVar("Other")

_WIDTH = 8
"""So many are worked on at a time, whatever the batch: XLA would round otherwise with others."""


def rarely(
    needed: jax.Array,
    work: Callable[[Tree, Other], Tree],
    state: Tree,
    context: Other,
    parts: tuple[int, ...] = (),
) -> Tree:
    """Does a piece of work for those of a batch that need it, some at a time.

    A GPU does it in one kernel, where those who do not need it go by.

    Args:
        needed: for whom, bool [B].
        work: from a state and a context to the state after; their last axis is a batch of any size.
        state: last axis B.
        context: last axis B.
        parts: as in `as_kernel`.

    Returns:
        The state, worked on where needed, last axis B.
    """
    if gpu.on_gpu():
        needed = jnp.broadcast_to(needed, (*parts, *needed.shape))
        return as_kernel(functools.partial(where_needed, work), parts)(needed, state, context)
    batch = needed.shape[0]
    width = min(_WIDTH, batch)
    # Places past the end are of none: read as the last, never written.
    order = jnp.nonzero(needed, size=batch + width, fill_value=batch)[0].astype(jnp.int32)
    count = needed.sum(dtype=jnp.int32)

    def some(carry: tuple[jax.Array, Tree]) -> tuple[jax.Array, Tree]:
        begin, state = carry
        lanes = jax.lax.dynamic_slice(order, (begin,), (width,))
        taken, beside = jax.tree.map(
            lambda leaf: jnp.take(leaf, lanes, axis=-1, mode="clip"), (state, context)
        )
        done = work(taken, beside)
        state = jax.tree.map(
            lambda leaf, new: leaf.at[..., lanes].set(new, mode="drop"), state, done
        )
        return begin + width, state

    _, state = jax.lax.while_loop(lambda carry: carry[0] < count, some, (jnp.int32(0), state))
    return state


def where_needed(
    work: Callable[[Tree, Other], Tree], needed: jax.Array, state: Tree, context: Other
) -> Tree:
    """The work, if anybody needs it, for those who do; see `rarely`."""

    def worked() -> Tree:
        done = work(state, context)
        result: Tree = jax.tree.map(lambda new, old: jnp.where(needed, new, old), done, state)
        return result

    result: Tree = jax.lax.cond(needed.any(), worked, lambda: state)
    return result
