"""Training episodes as they are drawn: a return that rises, and a boundary that stays."""

from typing import Any

import numpy as np

from hitl_jax.results.episode_tables import EPISODE_COLUMNS, METHODS


def make_training(method: str, seed: int, count: int = 40) -> dict[str, Any]:
    noise = np.random.default_rng([METHODS.index(method), seed])
    human = method != "srl"
    columns = dict.fromkeys(EPISODE_COLUMNS, np.zeros(count)) | {
        "episode": np.arange(1, count + 1),
        "return": np.linspace(-100.0, 300.0, count) + noise.normal(0.0, 20.0, count),
        "env_steps": np.cumsum(noise.integers(50, 1600, count)),
        "interventions": noise.integers(0, 2, count) * human,
        "end": ["fall"] * count,
    }
    columns["human_steps"] = 50 * columns["interventions"]
    boundary = np.full(count, 0.7 if human else np.nan)
    return columns | {"mean_boundary": boundary, "final_boundary": boundary}
