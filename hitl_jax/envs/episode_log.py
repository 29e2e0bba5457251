"""`EpisodeLog` keeps the steps of the episodes that walkers are in; `playback` replays actions."""

from collections.abc import Iterator, Mapping

import numpy as np

from hitl_jax.envs.base import Command


class EpisodeLog:
    """The steps so far of each walker's current episode, on the host."""

    def __init__(self, num_walkers: int, width: int):
        """Starts with empty episodes.

        Args:
            num_walkers: N.
            width: W, numbers kept of each step.
        """
        self._steps = np.zeros((num_walkers, 0, width), np.float32)
        self._length = np.zeros(num_walkers, int)
        self._walkers = np.arange(num_walkers)

    def add(self, live: np.ndarray, steps: np.ndarray) -> None:
        """Adds a step of some walkers.

        Args:
            live: which walkers made a step, bool [N].
            steps: numbers of the step, read where `live` [N, W].
        """
        try:
            # Written for all walkers: entries past an episode's length are not read.
            self._steps[self._walkers, self._length] = steps
        except IndexError:
            self._grow_to(self._length.max() + 1)
            self._steps[self._walkers, self._length] = steps
        self._length += live

    def add_several(self, live: np.ndarray, steps: np.ndarray) -> None:
        """Adds the steps of several ticks.

        Args:
            live: which walkers made a step at which tick, bool [N, U].
            steps: numbers of the steps, read where `live` [N, U, W].
        """
        places = self._length[:, None] + live.cumsum(axis=1)  # Behind each step.
        self._length = places[:, -1]
        self._grow_to(self._length.max())
        walkers, ticks = live.nonzero()
        self._steps[walkers, places[walkers, ticks] - 1] = steps[walkers, ticks]

    def begin(self, walker: int, steps: np.ndarray | None = None) -> None:
        """Begins a walker's episode anew.

        Args:
            walker: its index.
            steps: steps that the episode has already [T, W]; none by default.
        """
        length = 0 if steps is None else len(steps)
        self._grow_to(length)
        self._steps[walker, :length] = 0.0 if steps is None else steps
        self._length[walker] = length

    def _grow_to(self, length: int) -> None:
        """Makes room for episodes of this length."""
        if (lack := length - self._steps.shape[1]) > 0:
            before = self._steps
            num_walkers, room, width = before.shape
            self._steps = np.zeros((num_walkers, room + max(lack, room, 256), width), np.float32)
            self._steps[:, :room] = before

    def length_of(self, walker: int) -> int:
        """Number of steps of a walker's episode so far."""
        return int(self._length[walker])

    def of(self, walker: int) -> np.ndarray:
        """A copy of the steps of a walker's episode, [T, W]."""
        return self._steps[walker, : self._length[walker]].copy()


def playback(
    num_walkers: int, episodes: Mapping[int, np.ndarray]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The ticks that reset some walkers and replay their actions; other walkers are idle.

    Args:
        num_walkers: N.
        episodes: actions [T, A] by walker; at least one walker.

    Yields:
        Commands [N] and actions [N, A] of a tick.
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
