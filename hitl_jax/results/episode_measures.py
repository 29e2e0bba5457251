"""The measures of an episode, in training and test alike (host, NumPy).

A further number in episodes.csv is one more line in `MEASURES`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

ALARM_WINDOW = 50
"""k of "falls within k steps": alarms count as timely in the last second before a fall."""

FALL_REWARD = -100.0
"""BipedalWalker's reward for the step in which it falls."""

NAN = float("nan")

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
        shaped: the reward that is learned from, see `arbiter.shaped_reward`.
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


class Measure(NamedTuple):
    """A number, or a word, that is told of an episode: a column of the tables.

    Attributes:
        name: of the column.
        of: its value, from the episode and how it ended.
        of_a_fall_at_once: its value where an episode could not be played.
        kind: `count`, `number`, or `text` (one of `episode_tables.ENDS`).
        in_tests: whether tables of tests have it too.
        may_be_nan: whether there may be no value.
        absent: its value in tables of an earlier version, which lack the column; None if all have
            it.
    """

    name: str
    of: Callable[[Episode, str], Any]
    of_a_fall_at_once: Any
    kind: str = "count"
    in_tests: bool = True
    may_be_nan: bool = False
    absent: float | None = None


MEASURES = (
    # The sum of r(s, a).
    Measure("return", lambda e, _: _sum(e.reward), FALL_REWARD, "number"),
    # The sum of what the learner is given: of equation (7), unless the reward has another weight.
    Measure("shaped_return", lambda e, _: _sum(e.shaped), FALL_REWARD, "number", in_tests=False),
    # Environment steps.
    Measure("length", lambda e, _: len(e.reward), 1),
    # Interventions that began.
    Measure("interventions", lambda e, _: _count(e.began), 0),
    # Steps in which the human's action was executed.
    Measure("human_steps", lambda e, _: _count(e.human_action), 0),
    # Steps with |c_t| >= |τ_t|; of these, those in which the human saw danger, and the others.
    Measure("alarms", lambda e, _: _count(e.alarmed), 0),
    Measure("true_alarms", lambda e, _: _count(e.alarmed & e.dangerous), 0),
    Measure("false_alarms", lambda e, _: _count(e.alarmed & ~e.dangerous), 0),
    # Whether the episode ended by a fall, and how it ended.
    Measure("fall", lambda _, end: int(end == "fall"), 1),
    Measure("end", lambda _, end: end, "fall", "text"),
    # τ over the episode, and at its last step, in the indicator's unit; NaN without an arbiter.
    Measure("mean_boundary", lambda e, _: _mean(e.boundary), NAN, "number", may_be_nan=True),
    Measure("final_boundary", lambda e, _: float(e.boundary[-1]), NAN, "number", False, True),
    # Alarms in the last second before a fall, and the steps from the first of them to the fall.
    Measure("alarms_before_fall", lambda e, end: len(_timely(e, end)), 0),
    Measure("lead_steps", lambda e, end: _lead(e, end), NAN, "number", may_be_nan=True),
)
"""In the order of the columns."""


def fall_at_once() -> Row:
    """The row of an episode that could not be played since the numbers were not finite.

    It counts against the method, as a fall of BipedalWalker in the first step.
    """
    return {measure.name: measure.of_a_fall_at_once for measure in MEASURES}


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
    last = (float(episode.reward[-1]), bool(episode.terminated[-1]), bool(episode.human_reset[-1]))
    end = how_it_ended(*last, rule)
    return {measure.name: measure.of(episode, end) for measure in MEASURES}


def _count(values: np.ndarray) -> int:
    return int(np.count_nonzero(values))


def _sum(values: np.ndarray) -> float:
    """In the order of the steps, as one adds them up while they come."""
    return float(values.cumsum(dtype=float)[-1])


def _mean(values: np.ndarray) -> float:
    return _sum(values) / len(values)


def _timely(episode: Episode, end: str) -> np.ndarray:
    """Steps from each alarm in the last second before a fall to the fall, rising, [K]."""
    before_fall = episode.alarmed[-ALARM_WINDOW:] if end == "fall" else episode.alarmed[:0]
    return before_fall[::-1].nonzero()[0]


def _lead(episode: Episode, end: str) -> float:
    timely = _timely(episode, end)
    return float(timely[-1]) if len(timely) else NAN
