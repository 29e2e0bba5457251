"""A border that fusion on a CPU does not cross."""

from typing import TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

Tree = TypeVar("Tree")


@jax.jit
def _same(values: Tree) -> Tree:
    return values


def border(values: Tree) -> Tree:
    """Has values computed and kept, whatever is computed from them.

    XLA's fusion for CPUs computes a value again inside each kernel that uses it, and so on
    backwards. `optimization_barrier` does not help: it is gone before fusion. A call that may not
    be inlined stays.

    Args:
        values: arrays.

    Returns:
        The same.
    """
    with set_xla_metadata(inlineable="false"):
        return _same(values)
