"""Keeps XLA's CPU fusion from computing a value again: `fusion_barrier`.

The dense layers and the walker's solver use it. XLA's fusion for CPUs computes a value again inside
each kernel that uses it, and so on backwards through all that the value depends on.
"""

from typing import TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

Tree = TypeVar("Tree")


@jax.jit
def _identity(values: Tree) -> Tree:
    return values


def fusion_barrier(values: Tree) -> Tree:
    """Has values computed once and stored, whatever uses them.

    `jax.lax.optimization_barrier` does not do it: XLA removes it before fusion. XLA keeps a call
    that may not be inlined.

    Args:
        values: a pytree of arrays.

    Returns:
        The values, unchanged.
    """
    with set_xla_metadata(inlineable="false"):
        return _identity(values)
