"""Made-up runs of 1000 episodes, for claims to be judged on."""

import numpy as np

from hitl_jax.results.episode_tables import (
    EPISODE_COLUMNS,
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
    to_table,
)
from hitl_jax.results.folder import Run
from hitl_jax.results.run_key import RunKey


def make_run(
    method,
    seed,
    rises_at,
    test_return,
    assisted=0.0,
    end=0.45,
    interventions=(3, 1),
    falls_every=1,
):
    """A run that walks from one episode on, and falls in some of those before."""
    number = np.arange(1, 1001)
    tested = np.repeat(np.arange(50, 1000, 50), 2)
    alone = np.where(tested < rises_at, -100.0, test_return)
    progress = dict.fromkeys(PROGRESS_COLUMNS, np.zeros(76)) | {
        "trained": [*tested, *tested],
        "mode": ["autonomous"] * 38 + ["assisted"] * 38,
        "episode": [1, 10] * 38,
        "return": [*alone, *alone + assisted],
        "end": ["goal"] * 76,
    }
    training = dict.fromkeys(EPISODE_COLUMNS, np.zeros(1000)) | {
        "episode": number,
        "return": np.where(number < rises_at, -100.0, 300.0),
        "end": ["goal"] * 1000,
        "length": np.ones(1000),
        "env_steps": number,
        "fall": (number < rises_at) & (number % falls_every == 0),
        "interventions": np.where(number < 500, *interventions),
        "final_boundary": np.where(number < 300, 0.7, end),
    }
    tests = dict.fromkeys(TEST_COLUMNS, np.zeros(4)) | {
        "mode": ["autonomous"] * 2 + ["assisted"] * 2,
        "episode": [1, 2, 1, 2],
        "return": [test_return] * 2 + [test_return + assisted] * 2,
        "length": np.ones(4),
        "fall": [1, 1, 0, 0],
        "end": ["fall", "fall", "goal", "goal"],
        "lead_steps": [10.0, np.nan, np.nan, np.nan],
    }
    return Run(
        RunKey(method, seed),
        {"wall_seconds": 1.0},
        to_table(training, EPISODE_COLUMNS),
        to_table(tests, TEST_COLUMNS),
        progress=to_table(progress, PROGRESS_COLUMNS),
    )
