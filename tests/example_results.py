"""Small results, made up: a folder, its runs and their tables."""

from typing import Any

import numpy as np

from hitl_jax.results.episode_tables import EPISODE_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey

CONFIG = {
    "agent": {"learner": "td3", "matmul_precision": "float32", "hidden_sizes": (128, 128)},
    "hyper": {"gamma": 0.98},
}


KEY = RunKey("hitl-ac", 3)


def make_episodes(count: int = 4) -> dict[str, Any]:
    ones = np.ones(count, np.int64)
    table = dict.fromkeys(EPISODE_COLUMNS, ones)
    table |= {
        "episode": np.arange(1, count + 1),
        "return": np.linspace(-100.0, 300.0, count) / 3.0,
        "shaped_return": np.full(count, -0.1),
        "env_steps": 100 * np.arange(1, count + 1),
        "end": ["fall", "goal", "time-limit", "human-reset"][:count],
        "mean_boundary": np.full(count, 0.7),
        "final_boundary": np.full(count, np.nan),
        "lead_steps": np.array([12.0, np.nan, np.nan, np.nan])[:count],
    }
    return table


def make_tests() -> dict[str, Any]:
    episodes = make_episodes(2)
    return {n: episodes[n] for n in TEST_COLUMNS[1:]} | {"mode": ["autonomous", "assisted"]}


def make_params() -> dict[str, np.ndarray]:
    return {
        "actor/layer_0/kernel": np.arange(6, dtype=np.float32).reshape(2, 3),
        "actor/layer_0/bias": np.zeros(3, np.float32),
    }


def make_info(**changes: Any) -> dict[str, Any]:
    info = {"config": CONFIG, "versions": {"numpy": "2"}, "commit": None}
    info |= {"wall_seconds": np.float32(1.5), "env_steps": np.int64(400), "updates": 7}
    return info | changes


def save(folder: ResultsFolder, key: RunKey = KEY) -> None:
    folder.save_run(key, make_episodes(), make_tests(), make_params(), make_info())
