"""A run under way as it is saved, made up."""

import dataclasses

import numpy as np
from example_results import make_episodes

from hitl_jax.results.run_key import RunKey
from hitl_jax.training.saved_run import SavedRun

SAVED_KEY = RunKey("hitl-ac", 3)


def make_saved(ticks, new, key=SAVED_KEY):
    """A run after so many ticks, with its latest frames; frame t holds the number t."""
    columns = {name: np.asarray(values).tolist() for name, values in make_episodes().items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    facts = dataclasses.asdict(key) | {"ticks": ticks, "env_steps": ticks, "updates": 0}
    facts |= {
        "seconds": 1.5,
        "begun": True,
        "diverged": None,
        "recordings": {},
        "episodes": rows,
        "diagnostics": [],
    }
    return SavedRun(
        facts=facts,
        train=np.arange(3, dtype=np.uint32),
        acting=np.arange(4, dtype=np.uint32),
        behavior=np.ones((3, 2), np.float32),
        snapshots=np.zeros((0,)),
        boundaries=np.zeros((0,)),
        observation=np.full(2, ticks, np.float32),
        steps=np.zeros((0, 9), np.float32),
        recordings=np.zeros((0, 9), np.float32),
        frames=np.arange(ticks - new, ticks, dtype=np.float32)[:, None],
    )
