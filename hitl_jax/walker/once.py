"""A border that fusion on a CPU does not cross."""

from typing import TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

from hitl_jax.walker.kernel import on_gpu

Tree = TypeVar("Tree")


@jax.jit
def _same(values: Tree) -> Tree:
    return values


def once(values: Tree) -> Tree:
    """Has values computed once, and kept, where several others are computed from them.

    XLA's fusion for CPUs computes a value again inside each kernel that uses it, and so on
    backwards: the long chains of a solver grow by powers. `optimization_barrier` does not help: it
    is gone before fusion. A call that may not be inlined stays. For a GPU nothing is done.

    Args:
        values: arrays.

    Returns:
        The same.
    """
    if on_gpu():
        return values
    with set_xla_metadata(inlineable="false"):
        return _same(values)
