"""Early warnings: counted by hand."""

import numpy as np
import pytest

from hitl_jax.analysis.early_warnings import (
    EARLY,
    FALSE_ALARM_SHARES,
    count_precision,
    count_reliability,
    count_warnings,
    steps_to_fall,
)
from hitl_jax.results.episode_measures import ALARM_WINDOW


def test_steps_to_the_fall_are_counted_within_the_episode():
    assert steps_to_fall([2, 3], [False, True]).tolist() == [np.inf, np.inf, 3.0, 2.0, 1.0]


def _walks(alarm_at):
    """1,000 quiet steps, of which ten are loud; a fall whose last `alarm_at` steps are louder."""
    to_fall = steps_to_fall([1000, 200], [False, True])
    size = np.zeros(1200)
    size[:10] = 1.0
    size[1200 - alarm_at :] = 2.0
    return size, to_fall


@pytest.mark.parametrize(
    ("alarm_at", "warned"), [(0, 0), (EARLY - 1, 0), (EARLY, 1), (ALARM_WINDOW, 1)]
)
def test_a_fall_is_warned_of_if_the_alarm_is_early_enough(alarm_at, warned):
    rows = count_warnings(*_walks(alarm_at))
    assert [row["false_alarm_share"] for row in rows] == list(FALSE_ALARM_SHARES)
    for row in rows:
        quiet = 1000 + 200 - ALARM_WINDOW
        assert (row["quiet_steps"], row["falls"]) == (quiet, 1)
        assert row["false_alarms"] <= row["false_alarm_share"] * quiet
        assert (row["warned_falls"], row["lead_steps"]) == (warned, alarm_at)


def test_each_fall_counts_once_and_no_alarm_of_another_counts_for_it():
    to_fall = steps_to_fall([100, 100, 100], [True, False, True])
    size = np.zeros(300)
    size[55:70] = 1.0  # 45 to 31 steps before the first fall.
    [*_, row] = count_warnings(size, to_fall)
    assert (row["falls"], row["warned_falls"], row["lead_steps"]) == (2, 1, 45)


def test_without_a_quiet_step_there_is_no_rate_of_false_alarms():
    assert count_warnings(np.ones(10), steps_to_fall([10], [True])) == []


def test_reliability_by_hand():
    to_fall = steps_to_fall([1, 3], [False, True])
    rows = count_reliability(np.array([0.05, 0.0, 0.95, 1.0]), to_fall, horizon=2)
    assert rows[0] == {"bin": 0.0, "risk_sum": 0.05, "steps": 2, "falls_follow": 0}
    assert rows[9] == {"bin": 0.9, "risk_sum": 1.95, "steps": 2, "falls_follow": 2}
    assert sum(row["steps"] for row in rows) == 4


def test_precision_is_told_where_recall_is_reached():
    to_fall = steps_to_fall([100, 60], [True, False])
    size = np.where(to_fall <= 50, 100.0 - to_fall, 0.0)  # 50 to 99 before the fall, rising.
    size[[0, 110]] = 90.0
    rows = {row["recall"]: row for row in count_precision(size, to_fall)}
    assert rows[0.5]["boundary"] == 75.0
    assert (rows[0.5]["timely_alarms"], rows[0.5]["alarms"]) == (25, 27)
    assert (rows[0.95]["timely_alarms"], rows[0.95]["alarms"]) == (48, 50)
    assert count_precision(size, np.full(160, np.inf)) == []
