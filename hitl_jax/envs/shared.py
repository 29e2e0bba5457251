"""The arrays that a pool shares with its worker processes, in one anonymous file."""

import mmap
import struct
from typing import NamedTuple

import numpy as np

SIZES = struct.Struct("<2I")
"""A ready worker's first answer: O and A; both 0 if it cannot play the environment."""

REASON_BYTES = 2000
"""Longest reason that a worker gives when it cannot play the environment [bytes]."""


class SharedArrays(NamedTuple):
    """One tick of N walkers: the pool writes action, seed and command, the workers write the rest.

    Attributes:
        action: float32 [N, A].
        observation: float32 [N, O].
        seed: uint32 [N].
        reward: float32 [N].
        command: uint8 [N].
        terminated: bool [N].
        truncated: bool [N].
    """

    action: np.ndarray
    observation: np.ndarray
    seed: np.ndarray
    reward: np.ndarray
    command: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


def num_bytes(num_walkers: int, observation_size: int, action_size: int) -> int:
    """Size of the file [bytes]."""
    return num_walkers * (4 * (action_size + observation_size + 2) + 3)


def map_arrays(
    descriptor: int, num_walkers: int, observation_size: int, action_size: int
) -> SharedArrays:
    """Maps the file as arrays; the mapping lives as long as they do.

    Args:
        descriptor: of a file of `num_bytes` bytes; it may be closed afterwards.
        num_walkers: N.
        observation_size: O.
        action_size: A.
    """
    n = num_walkers
    memory = mmap.mmap(descriptor, num_bytes(num_walkers, observation_size, action_size))
    # The four-byte arrays come first, so that each is aligned.
    fields: list[tuple[tuple[int, ...], type]] = [
        ((n, action_size), np.float32),
        ((n, observation_size), np.float32),
        ((n,), np.uint32),
        ((n,), np.float32),
        ((n,), np.uint8),
        ((n,), np.bool_),
        ((n,), np.bool_),
    ]
    arrays = []
    offset = 0
    for shape, dtype in fields:
        array: np.ndarray = np.ndarray(shape, dtype, buffer=memory, offset=offset)
        arrays.append(array)
        offset += array.nbytes
    return SharedArrays(*arrays)
