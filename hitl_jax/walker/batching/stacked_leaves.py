"""A function mapped over a pytree's leaves as a few large arrays, to keep programs small."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def map_stacked(function: Callable[[jax.Array], jax.Array], tree: Tree) -> Tree:
    """Applies a function to a pytree's leaves: once to a stack of all leaves of each type.

    Args:
        function: of an array [leaves, ...] to an array [leaves, ...]; it treats each leaf alike.
        tree: of arrays of one shape.

    Returns:
        The tree of the results.
    """
    leaves, structure = jax.tree.flatten(tree)
    results: dict[int, jax.Array] = {}
    for dtype in {leaf.dtype: None for leaf in leaves}:
        places = [place for place, leaf in enumerate(leaves) if leaf.dtype == dtype]
        done = function(jnp.stack([leaves[place] for place in places]))
        results |= zip(places, done, strict=True)
    result: Tree = jax.tree.unflatten(structure, [results[place] for place in range(len(leaves))])
    return result
