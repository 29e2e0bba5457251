"""Names of the arrays in a pytree, by which a file holds them."""

from typing import Any

import chex
import jax

_LONGEST = 400
"""An archive's reader takes names of 500 letters."""


def by_name(tree: chex.ArrayTree) -> dict[str, Any]:
    """The leaves of a pytree by the path to them: `actor/params/Dense_0/kernel`, `actor/0/1`.

    Args:
        tree: of dictionaries, lists, dataclasses, or whatever JAX knows as a pytree.

    Returns:
        In the order of `jax.tree.leaves`.

    Raises:
        ValueError: one line, if two leaves would have the same name, or one has none for a file.
    """
    named: dict[str, Any] = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        name = "/".join(_step(key) for key in path)
        if name in named or len(name) > _LONGEST or not name.isprintable():
            raise ValueError(f"array {name[:50]!r}: must have a name of its own, for a file")
        named[name] = leaf
    return named


def from_names(like: chex.ArrayTree, named: dict[str, Any]) -> chex.ArrayTree:
    """The inverse of `by_name`.

    Args:
        like: a pytree with the structure of the named one.
        named: all its leaves, and perhaps others.
    """
    return jax.tree.unflatten(jax.tree.structure(like), [named[name] for name in by_name(like)])


def _step(key: Any) -> str:
    """One step of a path: the key of a dictionary, the place in a list, the name of a field."""
    for attribute in ("key", "idx", "name"):
        if hasattr(key, attribute):
            return str(getattr(key, attribute))
    return str(key)
