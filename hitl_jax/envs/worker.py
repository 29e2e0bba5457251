"""The program of a worker process, which steps some of a pool's walkers; `WorkerPool` starts it.

A worker first answers with the sizes of its spaces, or with sizes of 0 and the reason why it cannot
play the environment. Then each byte on its stdin is a tick, which it passes on to the next worker.
It reads commands and actions from the shared memory, writes the results there, and answers with a
byte. When its stdin closes, it ends: so no worker outlives its pool, even if the pool is killed.
"""

import contextlib
import gc
import os
import signal
import sys
from typing import Protocol

from hitl_jax.envs.shared import REASON_BYTES, SIZES, SharedArrays, map_arrays
from hitl_jax.errors import Unplayable

_NEW_OBJECTS = 50_000
"""New objects between two runs of the garbage collector."""


class Walkers(Protocol):
    """The walkers of one process.

    Attributes:
        observation_size: O.
        action_size: A.
    """

    observation_size: int
    action_size: int

    def tick(self, arrays: SharedArrays) -> None:
        """Does each walker's command; the pool has set reward and flags to 0."""
        ...


def main(
    backend: str,
    env_id: str,
    memory: int,
    reply: int,
    num_walkers: int,
    first: int,
    num_workers: int,
    wakes: int | None = None,
) -> None:
    """Serves walkers `first`, `first + num_workers`, ... until stdin closes.

    Args:
        backend: `lean` or `gymnasium`.
        env_id: gymnasium's name of the environment.
        memory: file descriptor of the shared memory; it gets its size before the first tick.
        reply: file descriptor of the pipe to the pool.
        num_walkers: N.
        first: this worker's first walker.
        num_workers: workers of the pool.
        wakes: file descriptor of the next worker's stdin; None for the last worker.
    """
    # The pool handles signals to the whole process group, such as Ctrl-C's.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    # A reset leaves a few reference cycles. A search for them after every 700 new objects, Python's
    # default, goes through all terrains and takes 3 % of a tick.
    gc.set_threshold(_NEW_OBJECTS)
    try:
        walkers = _make(backend, env_id, len(range(first, num_walkers, num_workers)))
    except Unplayable as error:
        os.write(reply, SIZES.pack(0, 0) + error.why.encode()[:REASON_BYTES])
        _await_tick(None)  # None comes: the pool reads the reason and closes stdin.
        return
    sizes = walkers.observation_size, walkers.action_size
    os.write(reply, SIZES.pack(*sizes))
    if not _await_tick(wakes):
        return
    arrays = SharedArrays(
        *(array[first::num_workers] for array in map_arrays(memory, num_walkers, *sizes))
    )
    while True:
        walkers.tick(arrays)
        os.write(reply, b".")
        if not _await_tick(wakes):
            return


def _await_tick(wakes: int | None) -> bool:
    """Sleeps until a tick begins, and wakes the next worker; False if stdin was closed."""
    asked = bool(os.read(0, 1))
    if asked and wakes is not None:
        with contextlib.suppress(BrokenPipeError):  # The next worker died; the pool notices it.
            os.write(wakes, b".")
    return asked


def _make(backend: str, env_id: str, num_walkers: int) -> Walkers:
    """The walkers of a backend."""
    if backend == "lean":
        from hitl_jax.envs.lean import LeanWalkers

        return LeanWalkers(env_id, num_walkers)
    from hitl_jax.envs.official import OfficialWalkers

    return OfficialWalkers(env_id, num_walkers)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
