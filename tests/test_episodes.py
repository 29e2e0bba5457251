import math

import numpy as np

from hitl_jax.episodes import ALARM_WINDOW, EpisodeCounter, Step


def _step(**changes):
    """One tick of two walkers; the second takes no step."""
    base = {
        "live": [True, False],
        "reward": [1.0, 50.0],
        "shaped": [1.0, 50.0],
        "terminated": [False, True],
        "truncated": [False, False],
        "human_reset": [False, False],
        "control": [False, True],
        "human_action": [False, True],
        "began": [False, True],
        "alarmed": [False, True],
        "dangerous": [False, True],
        "boundary": [0.5, 9.0],
    }
    return Step(**{name: np.array(value) for name, value in (base | changes).items()})


def test_counts_by_hand():
    counter = EpisodeCounter(2)
    assert counter.count(_step()) == []
    assert counter.count(_step(alarmed=[True, True], boundary=[0.7, 9.0])) == []
    ended = counter.count(
        _step(
            reward=[-100.0, 0.0],
            shaped=[-120.0, 0.0],
            terminated=[True, True],
            control=[True, True],
            human_action=[True, True],
            began=[True, True],
            alarmed=[True, True],
            dangerous=[True, True],
            boundary=[0.6, 9.0],
        )
    )
    ((walker, row),) = ended
    assert walker == 0
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


def test_totals_start_again_after_an_episode():
    counter = EpisodeCounter(2)
    counter.count(_step(truncated=[True, False], alarmed=[True, False]))
    ((_, row),) = counter.count(_step(truncated=[True, False]))
    assert (row["return"], row["length"], row["alarms"]) == (1.0, 1, 0)


def test_ends():
    def end(**changes):
        ((_, row),) = EpisodeCounter(2).count(_step(**changes))
        return row["end"], row["fall"]

    assert end(terminated=[True, False]) == ("goal", 0)
    assert end(terminated=[True, False], reward=[-100.0, 0.0]) == ("fall", 1)
    assert end(truncated=[True, False]) == ("time-limit", 0)
    assert end(human_reset=[True, False]) == ("human-reset", 0)
    assert end(human_reset=[True, False], terminated=[True, False], reward=[-100.0, 0]) == (
        "fall",
        1,
    )


def test_alarms_older_than_the_window_do_not_count():
    counter = EpisodeCounter(2)
    counter.count(_step(alarmed=[True, False]))
    for _ in range(ALARM_WINDOW - 1):
        counter.count(_step())
    ((_, row),) = counter.count(_step(terminated=[True, False], reward=[-100.0, 0.0]))
    assert row["alarms"] == 1
    assert row["alarms_before_fall"] == 0
    assert math.isnan(row["lead_steps"])
