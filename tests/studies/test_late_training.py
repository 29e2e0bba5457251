"""What an ablation tells of the last fifth of training."""

import numpy as np

from hitl_jax.results.folder import Run
from hitl_jax.results.run_key import RunKey
from hitl_jax.studies.ablations.late_training import late_training
from hitl_jax.studies.ablations.store import LATE


def test_what_became_of_the_last_episodes():
    """Of ten episodes the last two: one with an intervention, one without."""
    counts = np.array([1] * 8 + [2, 0])
    episodes = {
        "interventions": counts,
        "shaped_return": np.arange(10.0),
        "length": np.arange(10) + 100,
        "mean_boundary": np.full(10, np.nan),
    }
    run = Run(RunKey("hitl-fix", 0), {}, episodes, {})
    row = late_training(run, unattended_every=0)
    assert row.keys() == set(LATE)
    assert row == {
        "settled_boundary": None,
        "late_intervened": 0.5,
        "late_return_with": 8.0,
        "late_return_without": 9.0,
        "late_steps_with": 108.0,
        "late_steps_without": 109.0,
    }

    unattended = late_training(run, unattended_every=5)
    assert (unattended["late_intervened"], unattended["late_return_without"]) == (1.0, None)


def test_where_no_last_episode_was_helped_there_is_no_mean():
    none = {name: np.zeros(3) for name in ("interventions", "shaped_return", "length")}
    row = late_training(Run(RunKey("srl", 0), {}, none | {"mean_boundary": np.zeros(3)}, {}), 0)
    assert (row["late_intervened"], row["late_return_with"]) == (0.0, None)
    assert row["late_return_without"] == 0.0
