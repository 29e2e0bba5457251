"""How early indicators warn of falls at equal false alarms, and whether risks are true (NumPy)."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hitl_jax.results.episode_measures import ALARM_WINDOW

EARLY = 40
"""A fall is warned of in time where an alarm is raised so many steps before it, or earlier; that is
0.8 s."""

FALSE_ALARM_SHARES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
"""Of the steps that no fall follows within `ALARM_WINDOW` steps."""

NUM_BINS = 10
"""Of risks from 0 to 1."""

RECALLS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Shares of the steps that a fall follows within `ALARM_WINDOW` steps."""

PRECISION_COUNTS = ("alarms", "timely_alarms")
WARNING_COUNTS = ("quiet_steps", "false_alarms", "falls", "warned_falls", "lead_steps")
RELIABILITY_COUNTS = ("steps", "falls_follow")


def steps_to_fall(lengths: Sequence[int], fell: Sequence[bool]) -> np.ndarray:
    """Steps from each state to the fall, the step that ends in it included.

    Args:
        lengths: steps of each episode.
        fell: whether it ended in a fall.

    Returns:
        Of all episodes one after the other, [T]; infinite where none came.
    """
    episodes = zip(lengths, fell, strict=True)
    return np.concatenate(
        [
            np.arange(length, 0, -1.0) if down else np.full(length, np.inf)
            for length, down in episodes
        ]
    )


def count_warnings(size: np.ndarray, to_fall: np.ndarray) -> list[dict[str, Any]]:
    """What an indicator's alarms tell of falls, where each share of the quiet steps has an alarm.

    A step is quiet if no fall follows within `ALARM_WINDOW` steps. The boundary is the least at
    which no greater share of the quiet steps has an alarm. A fall is warned of if there is an alarm
    within the window and at least `EARLY` steps before it.

    Args:
        size: |c_t| of all steps of some episodes, [T].
        to_fall: of `steps_to_fall`, [T].

    Returns:
        For each of `FALSE_ALARM_SHARES` its `false_alarm_share`, the `boundary` that an alarm is
        above, and `WARNING_COUNTS`: `lead_steps` is the sum over falls with an alarm in the window
        of the steps from the first such alarm to the fall. Nothing where there is no quiet step.
    """
    quiet = np.sort(size[to_fall > ALARM_WINDOW])[::-1]
    near = to_fall <= ALARM_WINDOW
    fall = np.cumsum(to_fall == 1)  # Falls before this one: its number.
    number = np.where(to_fall == 1, fall - 1, fall)[near]
    rows = []
    for share in FALSE_ALARM_SHARES if quiet.size else ():
        boundary = quiet[min(int(share * quiet.size), quiet.size - 1)]
        first = np.zeros(int((to_fall == 1).sum()))
        alarmed = size[near] > boundary
        np.maximum.at(first, number[alarmed], to_fall[near][alarmed])
        rows.append(
            {
                "false_alarm_share": share,
                "boundary": float(boundary),
                "quiet_steps": quiet.size,
                "false_alarms": int((quiet > boundary).sum()),
                "falls": first.size,
                "warned_falls": int((first >= EARLY).sum()),
                "lead_steps": int(first.sum()),
            }
        )
    return rows


def count_precision(size: np.ndarray, to_fall: np.ndarray) -> list[dict[str, Any]]:
    """How many of an indicator's alarms come before a fall, where it is as sensitive as others.

    Args:
        size: |c_t| of all steps of some episodes, or how far it is above a boundary, [T].
        to_fall: of `steps_to_fall`, [T].

    Returns:
        For each of `RECALLS` the `recall`, the `boundary` at which at least that share of the steps
        within `ALARM_WINDOW` steps of a fall has an alarm, and `PRECISION_COUNTS`. Nothing where
        there is no fall.
    """
    near = np.sort(size[to_fall <= ALARM_WINDOW])[::-1]
    rows = []
    for recall in RECALLS if near.size else ():
        boundary = near[min(math.ceil(recall * near.size), near.size) - 1]
        rows.append(
            {
                "recall": recall,
                "boundary": float(boundary),
                "alarms": int((size >= boundary).sum()),
                "timely_alarms": int((near >= boundary).sum()),
            }
        )
    return rows


def count_reliability(risk: np.ndarray, to_fall: np.ndarray, horizon: int) -> list[dict[str, Any]]:
    """How often a fall followed where it was foretold with about the same probability.

    Args:
        risk: of all steps of some episodes, [T].
        to_fall: of `steps_to_fall`, [T].
        horizon: the risk is of a fall within so many steps.

    Returns:
        For each of `NUM_BINS` equal bins its least risk as `bin`, the sum of its risks as
        `risk_sum`, and `RELIABILITY_COUNTS`.
    """
    place = np.minimum((risk * NUM_BINS).astype(int), NUM_BINS - 1)
    follows = to_fall <= horizon
    return [
        {
            "bin": number / NUM_BINS,
            "risk_sum": float(risk[place == number].sum()),
            "steps": int((place == number).sum()),
            "falls_follow": int(follows[place == number].sum()),
        }
        for number in range(NUM_BINS)
    ]
