"""The walker in JAX beside gymnasium's and EnvPool's, over the number of walkers.

All are stepped through the same interface, with random actions and resets. The program is compiled
for each number of walkers and device, which takes longer than measuring it.
"""

import jax

from hitl_jax.benchmarks.pool import pool_rates
from hitl_jax.benchmarks.timing import REPEATS
from hitl_jax.results.episode_measures import Row
from hitl_jax.xla.cores import num_cores

BATCHES = (1, 16, 64, 256, 1024, 4096, 16384)
_MOST = {"lean": 256, "envpool": 1024}
"""More of them are no faster, and take long to make."""
_BACKENDS = ("lean", "envpool", "jax")


def measure_walkers(seconds: float) -> list[Row]:
    """Steps/s of each backend at each number of walkers, and the best of ours beside EnvPool's."""
    rows: list[Row] = []
    best: dict[str, tuple[float, int]] = {}
    for batch in BATCHES:
        row: Row = {"walkers": batch}
        for backend in _BACKENDS:
            if batch > _MOST.get(backend, BATCHES[-1]):
                continue
            try:
                stretches = pool_rates(backend, num_cores(), seconds / REPEATS, batch, REPEATS)
            except ImportError as error:
                row[f"{backend} steps/s"] = str(error)
                continue
            rate = max(stretches)
            row[f"{backend} steps/s"] = round(rate)
            best[backend] = max(best.get(backend, (0.0, 0)), (rate, batch))
        rows.append(row)
    for backend in best.keys() - {"jax"}:
        (rate, batch), (ours, where) = best[backend], best["jax"]
        told: Row = {"walkers": f"best of jax ({where}) / best of {backend} ({batch})"}
        told["ratio"] = round(ours / rate, 2)
        if backend == "envpool":
            told["bar"] = 1
        rows.append(told)
    rows.append({"walkers": f"jax ran on {jax.default_backend()}"})
    return rows
