"""A folder of made-up runs, for figures."""

from typing import Any

import numpy as np
from example_training import make_training

from hitl_jax.results.episode_tables import PROGRESS_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey

CONFIG = {
    "agent": {"indicator": "hull_angle", "boundary_source": "rule"},
    "hyper": {"initial_boundary": 0.7, "delta_minus": 1e-3, "delta_plus": 1e-3},
}


INFO = {"config": CONFIG, "versions": {}, "commit": None, "updates": 1}


NAMES = (
    "figure4_training",
    "figure4_steps",
    "figure5_test",
    "figure5_progress",
    "figure5_human_time",
    "figure6_boundary",
    "figure6_moves",
    "figure7_human",
)


def make_tests(method: str, modes: tuple[str, ...] = ("autonomous", "assisted")) -> dict[str, Any]:
    mode = [mode for mode in modes for _ in range(5)]
    columns = dict.fromkeys(TEST_COLUMNS, np.zeros(len(mode))) | {"end": ["goal"] * len(mode)}
    return columns | {"mode": mode, "return": 200.0 + 10.0 * np.arange(len(mode))}


def save(
    folder: ResultsFolder, method: str, seed: int, diverged: int | None = None, **modes: Any
) -> None:
    info = INFO | {"wall_seconds": 1.0, "env_steps": 1}
    if diverged is not None:
        info |= {"diverged": {"quantity": "action", "env_steps": 1, "episodes": diverged}}
    tests = make_tests(method, **modes)
    progress = {name: tests[name] for name in PROGRESS_COLUMNS[1:]}
    progress["trained"] = [10 if mode == "autonomous" else 20 for mode in tests["mode"]]
    folder.save_run(RunKey(method, seed), make_training(method, seed), tests, {}, info, progress)
