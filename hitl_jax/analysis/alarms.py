"""How well alarms foretell falls, at every boundary that one could have chosen (host, NumPy)."""

from typing import NamedTuple

import numpy as np

from hitl_jax.results.episode_measures import ALARM_WINDOW


class AlarmCounts(NamedTuple):
    """What alarms would have told over some episodes, at each of M boundaries.

    Attributes:
        steps: steps played, [].
        alarms: steps with |c_t| >= τ, [M].
        timely_alarms: those that a fall followed within k steps, [M].
        falls: episodes that ended with a fall, [].
        warned_falls: falls with an alarm in the k steps before, [M].
        lead_steps: sum over those of the steps from the first such alarm to the fall, [M].
    """

    steps: int
    alarms: np.ndarray
    timely_alarms: np.ndarray
    falls: int
    warned_falls: np.ndarray
    lead_steps: np.ndarray


def count_alarms(
    size: np.ndarray, fell: bool, boundaries: np.ndarray, window: int = ALARM_WINDOW
) -> AlarmCounts:
    """Counts one episode.

    Args:
        size: |c_t| at each step, [T].
        fell: whether the last step was a fall.
        boundaries: constant boundaries τ, [M].
        window: k, steps before a fall in which an alarm is timely.

    Returns:
        The counts; what depends on alarms is NaN where an indicator or a boundary is NaN.
    """
    unknown = np.isnan(boundaries) | np.isnan(size).any()
    alarmed = size[None, :] >= boundaries[:, None]
    timely = alarmed[:, -window:] if fell else alarmed[:, :0]
    warned = timely.any(axis=1)
    first = timely.argmax(axis=1) if fell else np.zeros(len(boundaries), int)
    return AlarmCounts(
        steps=size.size,
        alarms=_known(alarmed.sum(axis=1), unknown),
        timely_alarms=_known(timely.sum(axis=1), unknown),
        falls=int(fell),
        warned_falls=_known(warned.astype(int), unknown),
        lead_steps=_known(np.where(warned, timely.shape[1] - 1 - first, 0), unknown),
    )


def _known(counts: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    """Counts [M], NaN at the boundaries where they are unknown, bool [M]."""
    return np.where(unknown, np.nan, counts) if unknown.any() else counts


def total(counts: list[AlarmCounts]) -> AlarmCounts:
    """Counts of several episodes together; at least one."""
    return AlarmCounts._make(np.sum(values, axis=0) for values in zip(*counts, strict=True))
