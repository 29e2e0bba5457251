"""Work that only few of a batch need."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")
Other = TypeVar("Other")

_SHARE = 16
"""A sixteenth of the batch is worked on at a time."""


def rarely(
    needed: jax.Array, work: Callable[[Tree, Other], Tree], state: Tree, context: Other
) -> Tree:
    """Does a piece of work for those of a batch that need it, some at a time.

    Args:
        needed: for whom, bool [B].
        work: from a state and a context to the state after; their last axis is a batch of any size.
        state: last axis B.
        context: last axis B.

    Returns:
        The state, worked on where needed, last axis B.
    """
    batch = needed.shape[0]
    width = max(min(8, batch), batch // _SHARE)
    # Places past the end are of none: read as the last, never written.
    order = jnp.nonzero(needed, size=batch + width, fill_value=batch)[0]
    count = needed.sum()

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
