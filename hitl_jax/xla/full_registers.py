"""Fills batches up to whole vector registers, so that results do not depend on the batch's size.

The batches of runs and of walkers use it. XLA's CPU code rounds differently in a register that is
not full, so that a run's numbers would depend on how many runs are beside it.
"""

import math

import numpy as np

_LANES = 16
"""Numbers of 32 bits in the widest register (AVX-512)."""


def full(count: int) -> int:
    """The smallest number of rows that is at least `count` and fills all registers."""
    return math.ceil(count / _LANES) * _LANES


def filled(rows: np.ndarray, count: int) -> np.ndarray:
    """Rows with zeros appended.

    Args:
        rows: [R, ...].
        count: number of rows of the result, at least R.

    Returns:
        [`count`, ...].
    """
    return np.concatenate([rows, np.zeros((count - len(rows), *rows.shape[1:]), rows.dtype)])
