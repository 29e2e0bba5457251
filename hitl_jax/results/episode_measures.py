"""What is told of an episode, in training and test alike (host, NumPy)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

ALARM_WINDOW = 50
"""k of "falls within k steps": alarms count as timely in the last second before a fall."""

FALL_REWARD = -100.0
"""BipedalWalker's reward for the step in which it falls; another terminal step is the goal."""

Row = dict[str, Any]


class Episode(NamedTuple):
    """The steps of an episode that has ended, [T] each.

    Attributes:
        reward: r(s, a) of the environment.
        shaped: the reward of equation (7).
        began: whether an intervention began, bool.
        human_action: whether the human's action was executed, bool.
        alarmed: C, bool.
        dangerous: h_t = 0, bool.
        boundary: τ_t; NaN where there is none.
        terminated: the environment's end of the task, bool.
        human_reset: whether the human ended the episode, bool.
    """

    reward: np.ndarray
    shaped: np.ndarray
    began: np.ndarray
    human_action: np.ndarray
    alarmed: np.ndarray
    dangerous: np.ndarray
    boundary: np.ndarray
    terminated: np.ndarray
    human_reset: np.ndarray


NOT_FINITE = "not_finite"
"""Says in the row of a test episode that it was not played to its end, see `lost_test`."""


LOST_TESTS = "test episodes with numbers that are not finite, counted as falls"


def lost_test() -> Row:
    """The row of a test episode in which a number that acts, or that the plant gave, is not finite.

    By this rule all examiners go: the episode is not played on, and counts as `fall_at_once`.
    """
    return fall_at_once() | {NOT_FINITE: True}


def num_lost(rows: Sequence[Row]) -> int:
    """How many of some test episodes are such."""
    return sum(NOT_FINITE in row for row in rows)


def fall_at_once() -> Row:
    """The row of an episode that could not be played since the numbers were not finite.

    It counts against the method, as a fall in the first step.
    """
    counts = dict.fromkeys(("interventions", "human_steps", "alarms", "true_alarms"), 0)
    unknown = dict.fromkeys(("mean_boundary", "final_boundary", "lead_steps"), float("nan"))
    return {
        "return": FALL_REWARD,
        "shaped_return": FALL_REWARD,
        "length": 1,
        "fall": 1,
        "end": "fall",
        "false_alarms": 0,
        "alarms_before_fall": 0,
        **counts,
        **unknown,
    }


def row_of(episode: Episode) -> Row:
    """The measures of an episode that training and test share."""
    length = len(episode.reward)
    fall = bool(episode.terminated[-1]) and float(episode.reward[-1]) <= FALL_REWARD
    alarms = int(episode.alarmed.sum())
    true_alarms = int((episode.alarmed & episode.dangerous).sum())
    timely = np.flatnonzero(episode.alarmed[-ALARM_WINDOW:][::-1]) if fall else np.empty(0, int)
    return {
        "return": _sum(episode.reward),
        "shaped_return": _sum(episode.shaped),
        "length": length,
        "interventions": int(episode.began.sum()),
        "human_steps": int(episode.human_action.sum()),
        "alarms": alarms,
        "true_alarms": true_alarms,
        "false_alarms": alarms - true_alarms,
        "fall": int(fall),
        "end": _how_it_ended(fall, episode),
        "mean_boundary": _sum(episode.boundary) / length,
        "final_boundary": float(episode.boundary[-1]),
        "alarms_before_fall": len(timely),
        "lead_steps": float(timely[-1]) if len(timely) else float("nan"),
    }


def _sum(values: np.ndarray) -> float:
    """In the order of the steps, as one adds them up while they come."""
    return float(np.cumsum(values, dtype=float)[-1])


def _how_it_ended(fall: bool, episode: Episode) -> str:
    if fall:
        return "fall"
    if episode.terminated[-1]:
        return "goal"
    return "human-reset" if episode.human_reset[-1] else "time-limit"
