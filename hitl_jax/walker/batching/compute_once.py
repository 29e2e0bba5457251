"""Keeps XLA from computing a value again for each value that depends on it."""

from typing import TypeVar

from hitl_jax.xla import gpu
from hitl_jax.xla.fusion_barrier import fusion_barrier

Tree = TypeVar("Tree")


def once(values: Tree) -> Tree:
    """Has values computed once on a CPU, see `fusion_barrier`; on a GPU it does nothing.

    Without it each kernel would compute again what it uses, and a solver's chain of values would
    take exponentially many operations.

    Args:
        values: a pytree of arrays.

    Returns:
        The values, unchanged.
    """
    return values if gpu.on_gpu() else fusion_barrier(values)
