"""Episodes as they were played: with its reset seed, enough to play each again (host, NumPy)."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hitl_jax.results import npz_archives
from hitl_jax.results.npz_archives import Form

STEP_COLUMNS = ("boundary", "alarmed", "dangerous", "control", "human_action")
"""What is recorded of a step behind its action; the boundary is NaN without an arbiter, the others
are 0 or 1."""

_MOST_BYTES = 2**30
"""That the recordings of a run may unpack to: some millions of steps."""

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


def from_npz(
    data: bytes, lengths: np.ndarray, action_size: int | None = None
) -> dict[str, Recording]:
    """The recordings of a file, by name.

    Args:
        data: of the file: `NAME/episode` and `NAME/steps` for each.
        lengths: of the run's training episodes [steps], [E].
        action_size: A, if it is known.

    Raises:
        ValueError: one line, if they are no episodes of that run.
    """

    def require(forms: dict[str, Form]) -> None:
        for name in forms:
            recorded, _, field = name.rpartition("/")
            if field not in Recording._fields or f"{recorded}/steps" not in forms:
                raise ValueError(f"array {name!r}: is of no recorded episode")
            steps = forms[f"{recorded}/steps"]
            fits = len(steps.shape) == 2 and steps.dtype == np.float32
            if not fits or steps.shape[1] <= len(STEP_COLUMNS) or not steps.shape[0]:
                raise ValueError(f"steps of {recorded!r}: must be float32 [T, A + 5]")
            if action_size is not None and steps.shape[1] != action_size + len(STEP_COLUMNS):
                raise ValueError(f"steps of {recorded!r}: must be of {action_size} actions")
            if steps.shape[0] > lengths.max(initial=0):
                raise ValueError(f"steps of {recorded!r}: are more than of any episode")
            number = forms.get(f"{recorded}/episode")
            if number is None or number.shape or number.dtype.kind not in "iu":
                raise ValueError(f"episode of {recorded!r}: must be a whole number")

    arrays = npz_archives.from_npz(data, _MOST_BYTES, require)
    names = [name.removesuffix("/episode") for name in arrays if name.endswith("/episode")]
    kept = {
        name: Recording(int(arrays[f"{name}/episode"]), arrays[f"{name}/steps"]) for name in names
    }
    for name, one in kept.items():
        _require_played(name, one, lengths)
    return kept


def _require_played(name: str, one: Recording, lengths: np.ndarray) -> None:
    """Refuses what cannot be an episode of a run with these lengths."""
    if not 1 <= one.episode <= len(lengths) or len(one.steps) != lengths[one.episode - 1]:
        raise ValueError(f"recording {name!r}: is no episode of the run's table")
    if not np.isfinite(np.delete(one.steps, one.actions.shape[1], axis=1)).all():
        raise ValueError(f"recording {name!r}: holds numbers that are not finite")
    for flag in STEP_COLUMNS[1:]:
        if not np.isin(one.column(flag), (0.0, 1.0)).all():
            raise ValueError(f"recording {name!r}: {flag} must be 0 or 1")
