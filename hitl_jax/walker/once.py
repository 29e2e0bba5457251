"""Values that are computed once, where several others are computed from them."""

from typing import TypeVar

from hitl_jax.border import border
from hitl_jax.walker.kernel import on_gpu

Tree = TypeVar("Tree")


def once(values: Tree) -> Tree:
    """Keeps values on a CPU, where the long chains of a solver would grow by powers.

    For a GPU nothing is done.

    Args:
        values: arrays.

    Returns:
        The same.
    """
    return values if on_gpu() else border(values)
