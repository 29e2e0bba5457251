"""The episodes that walkers are in, step by step, and how to play them again (host, NumPy)."""

from collections.abc import Iterator, Mapping

import numpy as np

from hitl_jax.envs.base import Command


class EpisodeLog:
    """The steps so far of the episode that each walker is in."""

    def __init__(self, num_walkers: int, width: int):
        """Starts with empty episodes.

        Args:
            num_walkers: N.
            width: W, numbers that are kept of a step.
        """
        self._steps = np.zeros((num_walkers, 0, width), np.float32)
        self._length = np.zeros(num_walkers, int)
        self._walkers = np.arange(num_walkers)

    def add(self, live: np.ndarray, steps: np.ndarray) -> None:
        """Notes the steps [N, W] of the walkers that take one, bool [N]."""
        try:
            # For all walkers alike: what lies behind an episode's end is not read.
            self._steps[self._walkers, self._length] = steps
        except IndexError:
            self._make_room(self._length.max() + 1)
            self._steps[self._walkers, self._length] = steps
        self._length += live

    def begin(self, walker: int, steps: np.ndarray | None = None) -> None:
        """Forgets a walker's episode; `steps` [T, W] are those of the one it is in."""
        length = 0 if steps is None else len(steps)
        self._make_room(length)
        self._steps[walker, :length] = 0.0 if steps is None else steps
        self._length[walker] = length

    def _make_room(self, length: int) -> None:
        if (lack := length - self._steps.shape[1]) > 0:
            self._steps = np.pad(self._steps, ((0, 0), (0, max(lack, 256)), (0, 0)))

    def length_of(self, walker: int) -> int:
        """How many steps a walker's episode has."""
        return int(self._length[walker])

    def of(self, walker: int) -> np.ndarray:
        """A copy of a walker's steps, [T, W]."""
        return self._steps[walker, : self._length[walker]].copy()


def playback(
    num_walkers: int, episodes: Mapping[int, np.ndarray]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Ticks that bring walkers from a reset to where these actions lead; the others stay idle.

    Args:
        num_walkers: N.
        episodes: actions by walker, [T, A] each; at least one walker.

    Yields:
        Commands [N] and actions [N, A].
    """
    walkers = sorted(episodes)
    action = np.zeros((num_walkers, episodes[walkers[0]].shape[1]), np.float32)
    command = np.full(num_walkers, Command.IDLE, np.uint8)
    command[walkers] = Command.RESET
    yield command, action
    for step in range(max(len(actions) for actions in episodes.values())):
        command[:] = Command.IDLE
        for walker, actions in episodes.items():
            if step < len(actions):
                command[walker] = Command.STEP
                action[walker] = actions[step]
        yield command, action
