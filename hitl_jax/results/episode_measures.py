"""The measures of an episode, in training and test alike (host, NumPy)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

ALARM_WINDOW = 50
"""k of "falls within k steps": alarms count as timely in the last second before a fall."""

FALL_REWARD = -100.0
"""BipedalWalker's reward for the step in which it falls."""

Row = dict[str, Any]


class EndRule(NamedTuple):
    """What it means that the environment ends a task's episode (`terminated`).

    Attributes:
        fall_reward: a last reward of at most this is a fall; None where no fall is known.
        goal: whether every other such end is the goal; if not, it is told as "terminated".
    """

    fall_reward: float | None
    goal: bool


WALKER_ENDS = EndRule(FALL_REWARD, goal=True)
"""BipedalWalker's: it ends by a fall, which costs 100, or at the end of the terrain."""

UNKNOWN_ENDS = EndRule(None, goal=False)
"""Of an environment of which nothing is known."""


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
"""Key in the row of a test episode that was not played to its end, see `lost_test`."""


LOST_TESTS = "test episodes with numbers that are not finite, counted as falls"


def lost_test() -> Row:
    """The row of a test episode in which an action or an answer of the environment is not finite.

    All examiners end the episode there and count it as `fall_at_once`.
    """
    return fall_at_once() | {NOT_FINITE: True}


def num_lost(rows: Sequence[Row]) -> int:
    """How many rows of test episodes are those of `lost_test`."""
    return sum(NOT_FINITE in row for row in rows)


def fall_at_once() -> Row:
    """The row of an episode that could not be played since the numbers were not finite.

    It counts against the method, as a fall of BipedalWalker in the first step.
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


def how_it_ended(reward: float, terminated: bool, human_reset: bool, rule: EndRule) -> str:
    """The end of an episode, one of `episode_tables.ENDS`.

    A step can have several: a fall counts before the goal, that before the human's reset, and the
    time limit is what is left.

    Args:
        reward: the environment's, of the last step.
        terminated: whether the environment ended the task in it.
        human_reset: whether the human ended the episode in it.
        rule: of the task.
    """
    if terminated:
        if rule.fall_reward is not None and reward <= rule.fall_reward:
            return "fall"
        return "goal" if rule.goal else "terminated"
    return "human-reset" if human_reset else "time-limit"


def row_of(episode: Episode, rule: EndRule = WALKER_ENDS) -> Row:
    """The measures of an episode that training and test share.

    Args:
        episode: its steps.
        rule: what the end of an episode means in its task.
    """
    length = len(episode.reward)
    last = (float(episode.reward[-1]), bool(episode.terminated[-1]), bool(episode.human_reset[-1]))
    end = how_it_ended(*last, rule)
    alarms = int(episode.alarmed.sum())
    true_alarms = int((episode.alarmed & episode.dangerous).sum())
    before_fall = episode.alarmed[-ALARM_WINDOW:] if end == "fall" else episode.alarmed[:0]
    timely = np.flatnonzero(before_fall[::-1])
    return {
        "return": _sum(episode.reward),
        "shaped_return": _sum(episode.shaped),
        "length": length,
        "interventions": int(episode.began.sum()),
        "human_steps": int(episode.human_action.sum()),
        "alarms": alarms,
        "true_alarms": true_alarms,
        "false_alarms": alarms - true_alarms,
        "fall": int(end == "fall"),
        "end": end,
        "mean_boundary": _sum(episode.boundary) / length,
        "final_boundary": float(episode.boundary[-1]),
        "alarms_before_fall": len(timely),
        "lead_steps": float(timely[-1]) if len(timely) else float("nan"),
    }


def _sum(values: np.ndarray) -> float:
    """In the order of the steps, as one adds them up while they come."""
    return float(np.cumsum(values, dtype=float)[-1])
