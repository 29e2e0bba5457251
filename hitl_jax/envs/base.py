"""The interface of all pools of walkers (`WalkerPool`), and the checks that they share."""

import abc
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np

from hitl_jax.errors import InvalidValue
from hitl_jax.results.episode_measures import UNKNOWN_ENDS, EndRule


class Command:
    """What a walker does in one tick.

    Plain integers: a tick compares them a dozen times, and before Python 3.12 reading an enum's
    member takes a microsecond.
    """

    IDLE = 0
    STEP = 1
    RESET = 2


class StepBatch(NamedTuple):
    """The results of one tick; the caller may keep and change the arrays.

    There is no automatic reset: after its last STEP a walker waits for a RESET in a later tick.
    `terminated` and `truncated` can both be true: a fall in the step that reaches the time limit.

    Attributes:
        observation: after a STEP s_{t+1}, the true final one where the episode ended; after a RESET
            the first of the new episode; after an IDLE the last one again, zeros before the first
            RESET. float32 [N, O].
        reward: r(s, a) of a STEP, else 0. float32 [N].
        terminated: whether the STEP ended the task: a fall or the goal. bool [N].
        truncated: whether the STEP reached the time limit. bool [N].
    """

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


class WalkerPool(Protocol):
    """N walkers that tick together.

    Attributes:
        num_walkers: N.
        observation_size: O.
        action_size: A.
        seedable: whether a RESET honours its seed, so that an episode can be repeated.
        ends: what it means that the environment ends an episode; a pool may lack it, see `ends_of`.
    """

    num_walkers: int
    observation_size: int
    action_size: int
    seedable: bool
    ends: EndRule

    def send(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        """Starts a tick and returns without waiting for it.

        Args:
            command: a `Command` for each walker, uint8 [N].
            action: read where the command is STEP; in [-1, 1]. If the environment has other bounds,
                the pool clips and scales it onto them; if its bounds are [-1, 1], the environment
                clips. float32 [N, A].
            seed: read where the command is RESET, if the pool is `seedable`. uint32 [N].

        Raises:
            ValueError: for a wrong shape or command, an action that is not finite, or a STEP of a
                walker whose episode has ended or never began.
            RuntimeError: if the pool is closed, or the previous tick was not received.
        """
        ...

    def recv(self) -> StepBatch:
        """Waits for the end of the tick.

        Returns:
            The tick's results.

        Raises:
            WalkerError: if a worker raised, or was killed again and again; the pool is then closed.
            RuntimeError: if no tick was sent.
        """
        ...

    def step(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> StepBatch:
        """Calls `send`, then `recv`."""
        ...

    def close(self) -> None:
        """Ends all workers. May be called twice."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...


def ends_of(pool: WalkerPool) -> EndRule:
    """What the ends of a pool's episodes mean; of a pool that does not say, nothing is known."""
    return getattr(pool, "ends", UNKNOWN_ENDS)


def require_sizes(pool: WalkerPool, observation_size: int, action_size: int) -> None:
    """Refuses a team whose sizes are not those of the walkers.

    Args:
        pool: the walkers.
        observation_size: the team's O.
        action_size: the team's A.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    for name, value in (("observation_size", observation_size), ("action_size", action_size)):
        if value != getattr(pool, name):
            raise InvalidValue(name, value, f"must be {getattr(pool, name)}, as the walkers have")


class CheckedPool(abc.ABC):
    """A `WalkerPool` without its walkers: checks arguments, order of calls, who is in an episode.

    A subclass steps the walkers.
    """

    seedable: bool
    ends: EndRule = UNKNOWN_ENDS

    def __init__(self, num_walkers: int, observation_size: int, action_size: int):
        """Starts with all walkers waiting for their first RESET.

        Args:
            num_walkers: N.
            observation_size: O.
            action_size: A.
        """
        self.num_walkers = num_walkers
        self.observation_size = observation_size
        self.action_size = action_size
        self._playing = np.zeros(num_walkers, bool)
        self._sent: np.ndarray | None = None
        self._closed = False

    @abc.abstractmethod
    def _start(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        """Starts a tick whose arguments have been checked."""

    @abc.abstractmethod
    def _finish(self, command: np.ndarray) -> StepBatch:
        """Waits for the end of the tick that `command` started."""

    @abc.abstractmethod
    def _shutdown(self) -> None:
        """Ends all workers; called once."""

    def send(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        """Starts a tick; see `WalkerPool.send`."""
        if self._closed:
            raise RuntimeError("send: the pool is closed")
        if self._sent is not None:
            raise RuntimeError("send: the tick before was not received; call recv first")
        command = np.array(command, np.uint8)  # A copy: recv reads it again.
        action = np.asarray(action, np.float32)
        seed = np.asarray(seed, np.uint32)
        self._check(command, action, seed)
        self._start(command, action, seed)
        self._sent = command

    def recv(self) -> StepBatch:
        """Waits for the end of the tick; see `WalkerPool.recv`."""
        if self._sent is None:
            raise RuntimeError("recv: no tick was sent")
        batch = self._finish(self._sent)
        self._playing |= self._sent == Command.RESET
        self._playing &= ~(batch.terminated | batch.truncated)
        self._sent = None
        return batch

    def step(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> StepBatch:
        """Calls `send`, then `recv`."""
        self.send(command, action, seed)
        return self.recv()

    def close(self) -> None:
        """Ends all workers. May be called twice."""
        if not self._closed:
            self._closed = True
            self._sent = None
            self._shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _check(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        """Raises ValueError, one line, for a tick that cannot be played."""
        num = self.num_walkers
        shapes = {"command": (num,), "action": (num, self.action_size), "seed": (num,)}
        for (name, shape), array in zip(shapes.items(), (command, action, seed), strict=True):
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}: must be {shape}")
        if command.max() > Command.RESET:
            raise ValueError(f"command {command.max()}: must be one of [0, 1, 2]")
        stepped = command == Command.STEP
        not_playing = stepped & ~self._playing
        if not_playing.any():
            walker = int(not_playing.argmax())
            raise ValueError(f"command STEP of walker {walker}: not in an episode, RESET it first")
        # Box2D accepts NaN, and then computes nonsense or aborts the process.
        if not np.isfinite(action).all():
            broken = stepped & ~np.isfinite(action).all(axis=1)
            if broken.any():
                raise ValueError(f"action of walker {int(broken.argmax())}: must be finite")
