"""Episodes as they were played: with its reset seed, enough to play each again (host, NumPy)."""

from typing import Any, NamedTuple

import numpy as np

STEP_COLUMNS = ("boundary", "alarmed", "dangerous", "control", "human_action")
"""What is recorded of a step behind its action; the boundary is NaN without an arbiter, the others
are 0 or 1."""

FIRST_INTERVENTION, BEST = "first-intervention", "best"


class Recording(NamedTuple):
    """A training episode.

    Attributes:
        episode: its number in the run, counted from 1.
        steps: executed action and `STEP_COLUMNS` of each step, float32 [T, A + 5].
    """

    episode: int
    steps: np.ndarray

    @property
    def actions(self) -> np.ndarray:
        """The executed actions, [T, A]."""
        return self.steps[:, : -len(STEP_COLUMNS)]

    def column(self, name: str) -> np.ndarray:
        """One of `STEP_COLUMNS`, [T]."""
        return self.steps[:, STEP_COLUMNS.index(name) - len(STEP_COLUMNS)]


class EpisodeLog:
    """The steps so far of the episode that each walker is in."""

    def __init__(self, num_walkers: int, action_size: int):
        self.none = np.zeros((0, action_size + len(STEP_COLUMNS)), np.float32)
        """No step: an array [0, A + 5]."""
        self._steps = np.repeat(self.none[None], num_walkers, axis=0)
        self._length = np.zeros(num_walkers, int)

    def add(self, live: np.ndarray, steps: np.ndarray) -> None:
        """Notes the steps [N, A + 5] of the walkers that take one, bool [N]."""
        if self._length.max() >= self._steps.shape[1]:
            self._steps = np.pad(self._steps, ((0, 0), (0, 256), (0, 0)))
        walkers = np.flatnonzero(live)
        self._steps[walkers, self._length[walkers]] = steps[walkers]
        self._length[walkers] += 1

    def begin(self, walker: int, steps: np.ndarray | None = None) -> None:
        """Forgets a walker's episode; `steps` [T, A + 5] are those of the one it is in."""
        self._length[walker] = 0
        for step in () if steps is None else steps:
            live = np.arange(len(self._length)) == walker
            self.add(live, np.broadcast_to(step, (len(live), len(step))))

    def of(self, walker: int) -> np.ndarray:
        """A copy of a walker's steps, [T, A + 5]."""
        return self._steps[walker, : self._length[walker]].copy()


def names_of(episodes: list[dict[str, Any]], kept: dict[str, Recording]) -> list[str]:
    """As what the last of a run's episodes is to be recorded.

    Args:
        episodes: a row for each, the last included.
        kept: what is recorded so far, by name.
    """
    last = episodes[-1]
    names = []
    if last["interventions"] and FIRST_INTERVENTION not in kept:
        names.append(FIRST_INTERVENTION)
    if BEST not in kept or last["return"] > episodes[kept[BEST].episode - 1]["return"]:
        names.append(BEST)
    return names
