"""Rows of a batch, filled up to whole vector registers.

Where a register is not full, XLA's code for a CPU rounds otherwise, and the numbers of a run or an
episode would tell how many there were beside it.
"""

import math

import numpy as np

_LANES = 16
"""Numbers of 32 bits in the widest register (AVX-512)."""


def full(count: int) -> int:
    """The least number of rows, not below `count`, that fills all registers."""
    return math.ceil(count / _LANES) * _LANES


def filled(rows: np.ndarray, count: int) -> np.ndarray:
    """The rows, [R, ...], and zeros behind them, [`count`, ...]."""
    return np.concatenate([rows, np.zeros((count - len(rows), *rows.shape[1:]), rows.dtype)])
