"""Does work that only few elements of a batch need, for these alone."""

import functools
import math
from collections.abc import Callable
from typing import TypeVar

import chex
import jax
import jax.numpy as jnp

from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.xla import gpu

Tree = TypeVar("Tree")
Other = TypeVar("Other")
_Rows = dict[str, jax.Array]

_WIDTH = 8
"""Elements that are worked on at a time. Fixed, since XLA's rounding depends on it."""


def apply_to_subset(
    needed: jax.Array,
    work: Callable[[Tree, Other], Tree],
    state: Tree,
    context: Other,
    parts: tuple[int, ...] = (),
) -> Tree:
    """Applies a function to those elements of a batch that need it, a few at a time.

    On a GPU it is one kernel, in which the threads of other elements do nothing.

    Args:
        needed: which elements, bool [B].
        work: from a state and a context to the new state; their last axis is a batch of any size.
        state: last axis B.
        context: last axis B, or 1.
        parts: as in `as_kernel`.

    Returns:
        The new state where needed, the old one elsewhere; last axis B.
    """
    if gpu.on_gpu():
        needed = jnp.broadcast_to(needed, (*parts, *needed.shape))
        return as_kernel(functools.partial(apply_masked, work), parts)(needed, state, context)
    return jax.lax.cond(
        needed.any(),
        functools.partial(_some_at_a_time, work),
        lambda _, state, __: state,
        *(needed, state, context),
    )


def _some_at_a_time(
    work: Callable[[Tree, Other], Tree], needed: jax.Array, state: Tree, context: Other
) -> Tree:
    """Applies the function to `_WIDTH` elements after the other until all are done."""
    batch = needed.shape[0]
    width = min(_WIDTH, batch)
    # Indices past the end stand for no element: they read the last one and are never written.
    order = jnp.nonzero(needed, size=batch + width, fill_value=batch)[0].astype(jnp.int32)
    count = needed.sum(dtype=jnp.int32)

    def some(carry: tuple[jax.Array, _Rows]) -> tuple[jax.Array, _Rows]:
        begin, rows = carry
        lanes = jax.lax.dynamic_slice(order, (begin,), (width,))
        own, own_context = jax.tree.map(
            lambda leaf: jnp.take(leaf, lanes, axis=-1, mode="clip"), (rows, context)
        )
        done = _rows_of(work(_tree_of(state, own), own_context))
        rows = {name: rows[name].at[:, lanes].set(done[name], mode="drop") for name in rows}
        return begin + width, rows

    start = jnp.int32(0), _rows_of(state)
    _, rows = jax.lax.while_loop(lambda carry: carry[0] < count, some, start)
    return _tree_of(state, rows)


def _rows_of(tree: chex.ArrayTree) -> _Rows:
    """All leaves of each type as one array, [rows, B], so that one scatter writes them."""
    rows: dict[str, list[jax.Array]] = {}
    for leaf in jax.tree.leaves(tree):
        rows.setdefault(leaf.dtype.name, []).append(leaf.reshape(-1, leaf.shape[-1]))
    return {name: jnp.concatenate(parts) for name, parts in rows.items()}


def _tree_of(like: Tree, rows: _Rows) -> Tree:
    """The tree from the rows of `_rows_of`; types and shapes (without B) are those of `like`."""
    places = dict.fromkeys(rows, 0)

    def next_of(leaf: jax.Array) -> jax.Array:
        name, outer = leaf.dtype.name, leaf.shape[:-1]
        begin = places[name]
        places[name] += math.prod(outer)
        return rows[name][begin : places[name]].reshape(*outer, -1)

    result: Tree = jax.tree.map(next_of, like)
    return result


def apply_masked(
    work: Callable[[Tree, Other], Tree], needed: jax.Array, state: Tree, context: Other
) -> Tree:
    """Applies the function to all if any element needs it; the others keep their old state."""

    def worked() -> Tree:
        done = work(state, context)
        result: Tree = jax.tree.map(lambda new, old: jnp.where(needed, new, old), done, state)
        return result

    result: Tree = jax.lax.cond(needed.any(), worked, lambda: state)
    return result
