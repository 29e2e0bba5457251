"""One interface for pools of walkers, whatever steps them."""

import enum
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np


class WalkerError(RuntimeError):
    """A walker's process raised or died."""


class Command(enum.IntEnum):
    """What a walker does in one tick."""

    IDLE = 0
    STEP = 1
    RESET = 2


class StepBatch(NamedTuple):
    """What one tick brought; arrays that the caller may keep.

    Attributes:
        observation: after a STEP the true observation, the final one if the episode ended; after a
            RESET the first of the new episode; after IDLE the last; float32 [N, O].
        reward: of a STEP, 0 otherwise, float32 [N].
        terminated: whether the step ended the task, bool [N].
        truncated: whether it reached the time limit, bool [N]. Both may be true; neither is merged.
    """

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


class WalkerPool(Protocol):
    """N walkers that are stepped together. There is no automatic reset.

    Attributes:
        num_walkers: N.
        observation_size: O.
        action_size: A.
        seedable: whether a RESET takes its seed, so that episodes repeat.
    """

    num_walkers: int
    observation_size: int
    action_size: int
    seedable: bool

    def step(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> StepBatch:
        """One tick.

        Args:
            command: a `Command` for each walker, uint8 [N].
            action: read where the command is STEP, float32 [N, A].
            seed: read where the command is RESET, uint32 [N].

        Raises:
            WalkerError: if a walker's process raised or died.
        """
        ...

    def close(self) -> None:
        """Ends all processes; may be called twice."""
        ...

    def __enter__(self) -> Self:
        """For `with`."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Closes the pool."""
        self.close()
