"""Values that are computed once, where several others are computed from them."""

from typing import TypeVar

from hitl_jax.walker import gpu
from hitl_jax.xla.fusion_barrier import border

Tree = TypeVar("Tree")


def once(values: Tree) -> Tree:
    """Has values computed once on a CPU, see `border`; for a GPU nothing is done.

    Computed again in every kernel that uses them, a solver's chains would grow exponentially.

    Args:
        values: arrays.

    Returns:
        The same.
    """
    return values if gpu.on_gpu() else border(values)
