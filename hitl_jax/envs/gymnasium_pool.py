"""Official gymnasium walkers, several in each of a few worker processes, over shared memory."""

import itertools
import mmap
import os
import select
import subprocess
import sys
import tempfile
import time
from typing import IO

import gymnasium
import numpy as np

from hitl_jax.envs import shared
from hitl_jax.envs.base import StepBatch, WalkerError, WalkerPool

_START_SECONDS = 120.0
_POLL_SECONDS = 1.0
_ERROR_CHARACTERS = 400

_SINGLE_THREADED = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


class GymnasiumPool(WalkerPool):
    """N walkers over some worker processes.

    A walker's trajectory is a function of its seeds and actions alone: neither the number of
    workers nor its place among the walkers matters.
    """

    seedable = True

    def __init__(self, env_id: str, num_walkers: int, num_workers: int):
        """Starts the workers, all at once, and waits until they are ready.

        Args:
            env_id: an environment with a flat observation and flat actions.
            num_walkers: N.
            num_workers: processes, at most N.

        Raises:
            ValueError: if gymnasium does not know the environment, or its spaces are not flat.
            WalkerError: if a worker does not come up.
        """
        self.num_walkers = num_walkers
        self.observation_size, self.action_size = _sizes(env_id)
        sizes = (num_walkers, self.observation_size, self.action_size)
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the pool
        self._file.truncate(shared.size(*sizes))
        self._memory = mmap.mmap(self._file.fileno(), shared.size(*sizes))
        self._arrays = shared.views(self._memory, *sizes)
        self._errors: list[IO[bytes]] = []
        self._workers: list[subprocess.Popen] = []
        bounds = np.linspace(0, num_walkers, num_workers + 1).round().astype(int).tolist()
        for first, last in itertools.pairwise(bounds):
            self._start(env_id, sizes, first, last)
        self._poll = select.poll()
        self._by_descriptor: dict[int, int] = {}
        for index, worker in enumerate(self._workers):
            assert worker.stdout is not None
            self._by_descriptor[worker.stdout.fileno()] = index
            self._poll.register(worker.stdout.fileno(), select.POLLIN)
        try:
            self._wait(_START_SECONDS)
        except BaseException:
            self.close()
            raise

    def step(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> StepBatch:
        """One tick; see `WalkerPool.step`."""
        arrays = self._arrays
        arrays.command[:] = command
        arrays.action[:] = action
        arrays.seed[:] = seed
        for index, worker in enumerate(self._workers):
            assert worker.stdin is not None
            try:
                os.write(worker.stdin.fileno(), b".")
            except BrokenPipeError:
                self._fail(index)
        self._wait(None)
        return StepBatch(
            observation=arrays.observation.copy(),
            reward=arrays.reward.copy(),
            terminated=arrays.terminated.copy(),
            truncated=arrays.truncated.copy(),
        )

    def close(self) -> None:
        """Ends the workers; may be called twice."""
        for worker in self._workers:
            assert worker.stdin is not None and worker.stdout is not None
            worker.stdin.close()
        for worker in self._workers:
            try:
                worker.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                worker.kill()
                worker.wait()
            assert worker.stdout is not None
            worker.stdout.close()
        for file in (*self._errors, self._file):
            file.close()
        self._workers, self._errors = [], []

    def _start(self, env_id: str, sizes: tuple[int, int, int], first: int, last: int) -> None:
        errors = tempfile.TemporaryFile()  # noqa: SIM115 - likewise
        numbers = (self._file.fileno(), *sizes, first, last)
        self._errors.append(errors)
        self._workers.append(
            subprocess.Popen(
                [sys.executable, "-m", "hitl_jax.envs.worker", env_id, *map(str, numbers)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                pass_fds=(self._file.fileno(),),
                env=os.environ | _SINGLE_THREADED,
                bufsize=0,
            )
        )

    def _wait(self, seconds: float | None) -> None:
        """Waits for a byte of every worker.

        Raises:
            WalkerError: if one died, or did not answer in time.
        """
        waiting = set(range(len(self._workers)))
        deadline = None if seconds is None else time.monotonic() + seconds
        while waiting:
            for descriptor, _ in self._poll.poll(1000 * _POLL_SECONDS):
                if not os.read(descriptor, 1):
                    self._fail(self._by_descriptor[descriptor])
                waiting.discard(self._by_descriptor[descriptor])
            if waiting and deadline is not None and time.monotonic() > deadline:
                raise WalkerError(f"a walker process was not ready after {seconds:.0f} s")

    def _fail(self, index: int) -> None:
        """Raises for a worker whose pipe broke, with the end of what it said."""
        try:
            code = self._workers[index].wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            code = None
        self._errors[index].seek(0)
        said = self._errors[index].read().decode(errors="replace")
        said = " ".join(said.split())[-_ERROR_CHARACTERS:] or "no message"
        raise WalkerError(f"walker process {index} ended with exit code {code}: {said}")


def _sizes(env_id: str) -> tuple[int, int]:
    """O and A of an environment."""
    try:
        env = gymnasium.make(env_id, disable_env_checker=True)
    except gymnasium.error.Error as error:
        raise ValueError(f"env_id {env_id}: {error}") from error
    shapes = env.observation_space.shape, env.action_space.shape
    env.close()
    if any(shape is None or len(shape) != 1 for shape in shapes):
        raise ValueError(f"env_id {env_id}: observations and actions must be flat, not {shapes}")
    (observation,), (action,) = shapes  # type: ignore[misc]
    return observation, action
