"""`WorkerPool`: steps Box2D's walkers in a few worker processes, several walkers in each.

A dead worker is noticed in `WorkerPool._reply_unless_a_worker_died`; its pool then starts all
workers again and plays their episodes up to the tick (`_restart_and_repeat`).
"""

import contextlib
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import NoReturn, TypeVar

import numpy as np

from hitl_jax.envs.base import CheckedPool, Command, StepBatch
from hitl_jax.envs.episode_log import EpisodeLog, playback
from hitl_jax.envs.shared import REASON_BYTES, SIZES, map_arrays, num_bytes
from hitl_jax.envs.worker_process import CLOSE_SECONDS, WorkerProcess, launch
from hitl_jax.errors import Unplayable, WalkerError

_DEATH_CHECK_SECONDS = 0.1
"""How often a pool that waits for an answer looks whether a worker has died."""
_ATTEMPTS = 5
"""How often a tick is tried in which workers are killed; some walkers kill theirs each time."""

_logger = logging.getLogger(__name__)

T = TypeVar("T")


class _WorkerKilled(WalkerError):
    """A worker was killed by a signal: the same tick may succeed when it is tried again."""


class WorkerPool(CheckedPool):
    """N walkers over W worker processes, walker i in worker i mod W.

    An episode is a function of its seed and actions alone: neither W, nor the walker's index, nor
    its earlier episodes matter. It equals, bit for bit, the first episode of a new
    `gymnasium.make(env_id)` after `reset(seed=seed)`. So after a worker was killed the workers are
    started again and the walkers' episodes are replayed, and the caller sees no difference.
    """

    seedable = True

    def __init__(
        self,
        backend: str,
        env_id: str,
        num_walkers: int,
        num_workers: int,
        start_seconds: float = 120.0,
    ):
        """Starts all workers at once and waits until they are ready.

        Args:
            backend: `lean` or `gymnasium`.
            env_id: gymnasium's name of the environment, as in `gymnasium.make`.
            num_walkers: N.
            num_workers: W, at most N.
            start_seconds: time that the workers may take to come up [s].

        Raises:
            ValueError: if the environment cannot be played.
            WalkerError: if a worker fails, or does not come up in time.
        """
        self._names = (backend, env_id)
        self._numbers = (num_walkers, num_workers)
        self._start_seconds = start_seconds
        self._workers: list[WorkerProcess] = []
        self._memory = _anonymous_file()
        try:
            sizes = self._try_again_if_killed(self._launch_all)
            os.ftruncate(self._memory, num_bytes(num_walkers, *sizes))
            self._arrays = map_arrays(self._memory, num_walkers, *sizes)
        except BaseException:
            self._shutdown()
            raise
        super().__init__(num_walkers, *sizes)
        self._log = EpisodeLog(num_walkers, self.action_size)
        self._seeds = np.zeros(num_walkers, np.uint32)

    @property
    def process_ids(self) -> list[int]:
        """Process ids of the workers, in their order."""
        return [worker.process.pid for worker in self._workers]

    def _start(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        arrays = self._arrays
        arrays.command[:] = command
        arrays.action[:] = action
        arrays.seed[:] = seed
        # The workers write these for a STEP only.
        for array in (arrays.reward, arrays.terminated, arrays.truncated):
            array[:] = 0
        first = self._workers[0].process.stdin
        assert first is not None
        with contextlib.suppress(BrokenPipeError):  # The worker died; recv notices it.
            os.write(first.fileno(), b".")

    def _finish(self, command: np.ndarray) -> StepBatch:
        arrays = self._arrays
        try:
            try:
                self._await_replies(1)
            except _WorkerKilled as error:
                self._end_others_of_killed(error)
                asked = command, arrays.action.copy(), arrays.seed.copy()
                self._try_again_if_killed(lambda: self._restart_and_repeat(*asked))
        except WalkerError:
            self.close()
            raise
        for walker in (command == Command.RESET).nonzero()[0].tolist():
            self._log.begin(walker)
            self._seeds[walker] = arrays.seed[walker]
        self._log.add(command == Command.STEP, arrays.action)
        return StepBatch(
            observation=arrays.observation.copy(),
            reward=arrays.reward.copy(),
            terminated=arrays.terminated.copy(),
            truncated=arrays.truncated.copy(),
        )

    def _restart_and_repeat(
        self, command: np.ndarray, action: np.ndarray, seed: np.ndarray
    ) -> None:
        """Starts all workers again, replays the walkers' episodes, and repeats the tick.

        All workers, since the pool cannot know which walkers the others had stepped already.
        """
        self._launch_all()
        walkers = np.flatnonzero(self._playing).tolist()
        if walkers:
            episodes = {walker: self._log.of(walker) for walker in walkers}
            for commands, actions in playback(self.num_walkers, episodes):
                self._start(commands, actions, self._seeds)
                self._await_replies(1)
        self._start(command, action, seed)
        self._await_replies(1)

    def _try_again_if_killed(self, attempt: Callable[[], T]) -> T:
        """Calls a function that launches the workers; again if one is killed meanwhile."""
        for _ in range(_ATTEMPTS - 1):
            try:
                return attempt()
            except _WorkerKilled as error:
                self._end_others_of_killed(error)
        return attempt()

    def _end_others_of_killed(self, error: _WorkerKilled) -> None:
        """Ends the workers that are left, to start all again."""
        _logger.warning("%s; all are started again", error)
        self._end_workers()

    def _launch_all(self) -> tuple[int, int]:
        """Starts all workers at once and waits until they are ready.

        Returns:
            O and A.

        Raises:
            Unplayable: if a worker cannot play the environment.
        """
        num_walkers, num_workers = self._numbers
        # From the last to the first, since each gets the pipe that wakes the next. The pool wakes
        # the first alone: else that one could take the pool's core before the second is woken.
        for index in reversed(range(num_workers)):
            following = self._workers[0].process.stdin if self._workers else None
            worker = launch(*self._names, self._memory, num_walkers, index, num_workers, following)
            self._workers.insert(0, worker)
            if following is not None:
                following.close()
        answers = self._await_replies(SIZES.size, time.monotonic() + self._start_seconds)
        for worker, answer in zip(self._workers, answers, strict=True):
            if not any(SIZES.unpack(answer)):
                raise Unplayable(self._names[1], os.read(worker.reply, REASON_BYTES).decode())
        return SIZES.unpack(answers[0])

    def _await_replies(self, size: int, deadline: float = float("inf")) -> list[bytes]:
        """Sleeps until every worker has answered.

        Args:
            size: bytes in an answer.
            deadline: on the monotonic clock [s].

        Returns:
            The answers, in the workers' order.

        Raises:
            WalkerError: if a worker died, or the deadline passed.
        """
        # The last worker is woken last and mostly ends last, so the pool is woken once a tick.
        answers = [
            self._reply_unless_a_worker_died(worker, size, deadline)
            for worker in reversed(self._workers)
        ]
        return answers[::-1]

    def _reply_unless_a_worker_died(
        self, worker: WorkerProcess, size: int, deadline: float
    ) -> bytes:
        """Waits for one worker's answer; here, and nowhere else, a dead worker is noticed.

        There are two signs: the awaited worker's pipe is closed, so that a read gives no bytes; or
        the process of any worker has ended, which is looked at every `_DEATH_CHECK_SECONDS`. (A
        closed pipe is no sign of the other workers' deaths, nor of the awaited one's while another
        process, such as a fork of ours, holds the pipe open.)

        Args:
            worker: the awaited one; all workers after it have answered.
            size: bytes in an answer.
            deadline: on the monotonic clock [s].

        Returns:
            The answer.

        Raises:
            WalkerError: if a worker died, or the deadline passed.
        """
        while not worker.has_answered(_DEATH_CHECK_SECONDS):
            for each in self._workers:
                if each.process.poll() is not None:
                    self._raise_for_dead(each)
            if time.monotonic() >= deadline:
                late = sum(not each.has_answered(0.0) for each in self._workers[: worker.index + 1])
                who = f"{late} of {len(self._workers)} walker processes"
                raise WalkerError(f"{who} did not come up in time")
        answer = os.read(worker.reply, size)
        if not answer:
            self._raise_for_dead(worker)
        return answer

    def _raise_for_dead(self, worker: WorkerProcess) -> NoReturn:
        """Raises for a worker whose process has ended."""
        ending = worker.how_it_ended()
        if worker.process.returncode == 0 and worker.index > 0:
            # It ended since its stdin was closed: the worker before it, which holds that, is dead.
            self._raise_for_dead(self._workers[worker.index - 1])
        number = f"{worker.index + 1} of {len(self._workers)}"
        kind = (
            _WorkerKilled
            if worker.process.returncode and worker.process.returncode < 0
            else WalkerError
        )
        error = kind(f"walker process {number} {ending}")
        if log := worker.log_end():
            error.add_note(f"The end of its log:\n{log}")
        raise error

    def _shutdown(self) -> None:
        self._end_workers(CLOSE_SECONDS)
        os.close(self._memory)

    def _end_workers(self, seconds: float = 0.0) -> None:
        """Closes the workers' stdin, so that they end; after `seconds` kills those left."""
        for worker in self._workers:
            assert worker.process.stdin is not None
            worker.process.stdin.close()
        for worker in self._workers:
            try:
                worker.process.wait(seconds)
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()
            os.close(worker.reply)
            worker.log.close()
        self._workers = []


def _anonymous_file() -> int:
    """File descriptor of a file without a name, in memory where the system has such files."""
    if sys.platform == "linux":
        return os.memfd_create("hitl_jax")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
