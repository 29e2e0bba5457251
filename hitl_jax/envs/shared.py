"""The memory that a pool and its workers share: plain arrays in one anonymous file."""

import mmap
from typing import NamedTuple

import numpy as np


class SharedArrays(NamedTuple):
    """Views of the shared memory; see `WalkerPool.step` for their meaning.

    Attributes:
        action: float32 [N, A].
        observation: float32 [N, O].
        reward: float32 [N].
        seed: uint32 [N].
        command: uint8 [N].
        terminated: bool [N].
        truncated: bool [N].
    """

    action: np.ndarray
    observation: np.ndarray
    reward: np.ndarray
    seed: np.ndarray
    command: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


def size(num_walkers: int, observation_size: int, action_size: int) -> int:
    """Bytes of the shared memory."""
    return num_walkers * (4 * (action_size + observation_size + 2) + 3)


def views(
    memory: mmap.mmap, num_walkers: int, observation_size: int, action_size: int
) -> SharedArrays:
    """The arrays in a mapped file of `size` bytes, the wide ones first so that all are aligned."""
    n = num_walkers
    shapes = [
        ((n, action_size), np.float32),
        ((n, observation_size), np.float32),
        ((n,), np.float32),
        ((n,), np.uint32),
        ((n,), np.uint8),
        ((n,), np.bool_),
        ((n,), np.bool_),
    ]
    arrays, offset = [], 0
    for shape, dtype in shapes:
        array: np.ndarray = np.ndarray(shape, dtype, buffer=memory, offset=offset)
        arrays.append(array)
        offset += array.nbytes
    return SharedArrays(*arrays)
