import math

import numpy as np
import pytest

from hitl_jax.results.episode_measures import (
    ALARM_WINDOW,
    UNKNOWN_ENDS,
    WALKER_ENDS,
    EndRule,
    Episode,
    how_it_ended,
    row_of,
)
from hitl_jax.results.episode_tables import ENDS


def _episode(length, **changes):
    """An episode of equal steps, cut off by the time limit; lists say what its last steps were."""
    flags = ("began", "human_action", "alarmed", "dangerous", "terminated", "human_reset")
    columns = {name: np.zeros(length, bool) for name in flags}
    columns |= {"reward": np.ones(length), "shaped": np.ones(length)}
    columns["boundary"] = np.full(length, 0.5)
    for name, values in changes.items():
        columns[name][-len(values) :] = values
    return Episode(**columns)


def test_counts_by_hand():
    row = row_of(
        _episode(
            3,
            reward=[-100.0],
            shaped=[-120.0],
            terminated=[True],
            human_action=[True],
            began=[True],
            alarmed=[True, True],
            dangerous=[True],
            boundary=[0.7, 0.6],
        )
    )
    assert row["return"] == -98.0
    assert row["shaped_return"] == -118.0
    assert (row["length"], row["interventions"], row["human_steps"]) == (3, 1, 1)
    assert (row["alarms"], row["true_alarms"], row["false_alarms"]) == (2, 1, 1)
    assert (row["fall"], row["end"]) == (1, "fall")
    assert math.isclose(row["mean_boundary"], 0.6)
    assert row["final_boundary"] == 0.6
    # Alarms at steps 2 and 3 of 3; the fall is step 3: two timely alarms, the first one step
    # before.
    assert (row["alarms_before_fall"], row["lead_steps"]) == (2, 1.0)


def test_ends():
    def end(**changes):
        row = row_of(_episode(2, **changes))
        return row["end"], row["fall"]

    assert end(terminated=[True]) == ("goal", 0)
    assert end(terminated=[True], reward=[-100.0]) == ("fall", 1)
    assert end() == ("time-limit", 0)
    assert end(human_reset=[True]) == ("human-reset", 0)
    assert end(human_reset=[True], terminated=[True], reward=[-100.0]) == ("fall", 1)


_OWN_FALL = EndRule(fall_reward=-5.0, goal=False)


@pytest.mark.parametrize(
    ("rule", "reward", "end"),
    [
        (WALKER_ENDS, -100.0, "fall"),
        (WALKER_ENDS, -99.9, "goal"),
        (UNKNOWN_ENDS, -100.0, "terminated"),
        (UNKNOWN_ENDS, 300.0, "terminated"),
        (_OWN_FALL, -5.0, "fall"),
        (_OWN_FALL, -4.0, "terminated"),
        (EndRule(None, goal=True), -100.0, "goal"),
    ],
)
def test_an_end_is_the_goal_only_where_the_task_says_so(rule, reward, end):
    assert how_it_ended(reward, True, False, rule) == end
    assert end in ENDS
    row = row_of(_episode(3, reward=[reward], terminated=[True], alarmed=[True]), rule)
    fell = end == "fall"
    assert (row["end"], row["fall"], row["alarms_before_fall"]) == (end, fell, fell)


def test_ends_that_are_not_the_tasks_are_the_same_under_any_rule():
    for rule in (WALKER_ENDS, UNKNOWN_ENDS, _OWN_FALL):
        assert how_it_ended(-100.0, False, False, rule) == "time-limit"
        assert how_it_ended(-100.0, False, True, rule) == "human-reset"


def test_alarms_older_than_the_window_do_not_count():
    fall = {"terminated": [True], "reward": [-100.0]}
    early = [True] + [False] * ALARM_WINDOW
    row = row_of(_episode(ALARM_WINDOW + 1, alarmed=early, **fall))
    assert (row["alarms"], row["alarms_before_fall"]) == (1, 0)
    assert math.isnan(row["lead_steps"])
    row = row_of(_episode(ALARM_WINDOW + 1, alarmed=early[:-1], **fall))
    assert (row["alarms_before_fall"], row["lead_steps"]) == (1, ALARM_WINDOW - 1.0)


def test_rewards_are_added_in_the_order_of_the_steps():
    rewards = np.random.default_rng(0).normal(size=1000).astype(np.float32)
    total = 0.0
    for reward in rewards:
        total += float(reward)
    assert row_of(_episode(1000, reward=rewards))["return"] == total
