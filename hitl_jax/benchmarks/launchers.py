"""What Ray costs on one machine: the same sweep by both launchers, start and figures included."""

import importlib.util
import pathlib
import statistics
import subprocess
import tempfile
import time

from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.results.episode_measures import Row

_BAR = 1.05
_TURNS = ("local", "ray", "ray", "local")
"""Neighbours that come and go, and what one sweep leaves in the caches, meet both alike."""


def measure_launchers(seconds: float) -> list[Row]:
    """Times sweeps of two seeds of the three methods.

    Args:
        seconds: fifty times as many episodes a run are trained.
    """
    if importlib.util.find_spec("ray") is None:
        return [{"launcher": 'missing: pip install -e ".[ray]"'}]
    episodes = max(round(50 * seconds), 1)
    _sweep("local", 1)  # Compiles.
    took: dict[str, list[float]] = {}
    for launcher in _TURNS:
        took.setdefault(launcher, []).append(_sweep(launcher, episodes))
    plain = statistics.mean(took["local"])
    return [
        {
            "launcher": launcher,
            "episodes of each of 6 runs": episodes,
            "sweeps, s": ", ".join(f"{one:.1f}" for one in times),
            "of the plain sweep": round(statistics.mean(times) / plain, 3),
            "bar": _BAR if launcher == "ray" else "",
        }
        for launcher, times in took.items()
    ]


def _sweep(launcher: str, episodes: int) -> float:
    """How long a sweep takes [s]."""
    with tempfile.TemporaryDirectory() as folder:
        python, environment = child_interpreter()
        command = [*python, "-m", "hitl_jax", "sweep", "--launcher", launcher]
        command += ["--seeds", "2", "--episodes", str(episodes), "--test-episodes", "5"]
        command += ["--out", str(pathlib.Path(folder) / "sweep")]
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
        return time.perf_counter() - start
