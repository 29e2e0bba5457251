"""Episodes as they were played: with its reset seed, enough to play each again (host, NumPy)."""

from collections.abc import Mapping, Sequence
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


def index(kept: Mapping[str, Recording]) -> dict[str, list[int]]:
    """Number and length of each recorded episode, by name."""
    return {name: [one.episode, len(one.steps)] for name, one in kept.items()}


def join(kept: Mapping[str, Recording], width: int) -> np.ndarray:
    """The steps of all recordings, one after the other, [T, W]; none if there are none."""
    return np.concatenate([np.zeros((0, width), np.float32), *(one.steps for one in kept.values())])


def split(numbers: Mapping[str, Sequence[int]], steps: np.ndarray) -> dict[str, Recording]:
    """The recordings, from what `index` and `join` gave."""
    kept, place = {}, 0
    for name, (episode, length) in numbers.items():
        kept[name] = Recording(episode, steps[place : place + length])
        place += length
    return kept
