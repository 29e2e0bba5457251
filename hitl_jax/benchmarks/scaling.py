"""How rates, memory and start-up grow with the number of runs.

Each size is measured in a process of its own, started twice: first with an empty cache of compiled
programs, then with the filled one. Where JAX has an accelerator, everything runs there.
"""

import io
import json
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

import jax

from hitl_jax.analysis.figure_style import attempt
from hitl_jax.benchmarks.loop import play, specs_of, warm_up
from hitl_jax.benchmarks.timing import device_mb, memory_mb
from hitl_jax.config import AgentConfig, Method
from hitl_jax.envs import make_pool
from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.results.atomic_files import write_bytes_atomic
from hitl_jax.results.episode_measures import Row
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, num_slots

NUM_RUNS = (1, 3, 10, 30, 100)
NUM_RUNS_ON_ACCELERATOR = (30, 300, 1002)
CAPACITY_ON_ACCELERATOR = 50_000
"""The whole replay of 1,002 runs would take 28 GB."""
SLOTS = 128
SECOND_START_BAR = 15.0
MEMORY_BAR = 16.0

_PANELS: tuple[tuple[str, dict[str, str], float | None], ...] = (
    ("rate of all runs [1/s]", {"steps/s": "environment steps", "updates/s": "updates"}, None),
    ("cost of a step of one run [µs]", {"µs a run-step": "step and its updates"}, None),
    ("memory [GB]", {"memory GB": "all processes, or devices"}, MEMORY_BAR),
    (
        "start to first steps [s]",
        {"first start s": "first start", "second start s": "second start"},
        SECOND_START_BAR,
    ),
)
_LINES: tuple[dict[str, Any], ...] = (
    {"color": "#0072B2"},
    {"color": "#D55E00", "linestyle": "--"},
)


def measure_scaling(seconds: float) -> list[Row]:
    """A row for each number of runs, all seated at once, with the whole replay on a CPU."""
    sizes = NUM_RUNS if jax.default_backend() == "cpu" else NUM_RUNS_ON_ACCELERATOR
    rows: list[Row] = []
    for runs in sizes:
        with tempfile.TemporaryDirectory() as cache:
            first, second = (_started(runs, seconds, cache) for _ in range(2))
        start = second.pop("start s")
        rows.append(
            {
                **second,
                "first start s": first["start s"],
                "second start s": start,
                "bar s": SECOND_START_BAR,
            }
        )
        if runs == max(NUM_RUNS):
            rows[-1]["bar GB"] = MEMORY_BAR
    return rows


def draw_scaling(rows: list[Row], path: str) -> list[str]:
    """A picture of the table, four panels over the number of runs.

    Args:
        rows: of `measure_scaling`.
        path: a .png or .svg file.

    Returns:
        A line that says why it could not be drawn, if it could not.
    """
    return attempt({path: lambda: draw_rows(rows, pathlib.Path(path))}, changes={}).failures


def draw_rows(rows: list[Row], path: pathlib.Path) -> list[pathlib.Path]:
    """Draws rates, memory and start-up over the number of runs; the file written."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True)
    runs = [row["runs"] for row in rows]
    for axes, (label, names, bar) in zip(panels.flat, _PANELS, strict=True):
        for (name, shown), style in zip(names.items(), _LINES, strict=False):
            values = [row[name] for row in rows]
            axes.plot(runs, values, marker="o", markersize=4, label=shown, **style)
        if bar is not None:
            axes.axhline(bar, color="#444444", linewidth=0.8, linestyle=":", label="bar")
        axes.set(ylabel=label, xscale="log", ylim=(0, None))
        axes.set_xticks(runs, [str(number) for number in runs])
        axes.minorticks_off()
        axes.legend(framealpha=1, edgecolor="none", fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("runs at a time")
    picture = io.BytesIO()
    figure.savefig(picture, format=path.suffix[1:], dpi=200)
    write_bytes_atomic(path, picture.getvalue())
    return [path]


def _started(runs: int, seconds: float, cache: str) -> Row:
    python, environment = child_interpreter()
    program = [*python, "-m", "hitl_jax.benchmarks.scaling"]
    answer = subprocess.run(
        [*program, str(runs), str(seconds), str(time.time())],
        env={**environment, "JAX_COMPILATION_CACHE_DIR": cache},
        stdout=subprocess.PIPE,
        check=True,
        encoding="utf-8",
    )
    row: Row = json.loads(answer.stdout)
    return row


def _measure(runs: int, seconds: float, started: float) -> Row:
    """One size in this process; `started` is when its parent asked for it [s since the epoch]."""
    keep_programs()
    if jax.default_backend() == "cpu":
        backend, slots, config = "lean", num_slots(runs, SLOTS), LoopConfig()
    else:
        backend, slots = "jax", num_slots(runs, runs)
        config = LoopConfig(capacity=CAPACITY_ON_ACCELERATOR)
    with make_pool(backend, slots) as pool:
        specs = specs_of(list(Method), runs)
        rollout = Rollout(make_agent(AgentConfig()), specs, pool, config)
        chunks = iter(rollout)
        next(chunks)  # Every program has been compiled after one chunk.
        start = time.time() - started
        warm_up(rollout, chunks)
        played = play(rollout, chunks, 5 * seconds)
        memory = memory_mb(children=True) if backend == "lean" else device_mb()
    return {
        "runs": runs,
        "backend": f"{backend}, {jax.default_backend()}",
        "steps/s": round(played.steps / played.seconds),
        "updates/s": round(played.ticks * runs * config.updates_per_step / played.seconds),
        "µs a run-step": round(1e6 * played.seconds / played.steps),
        "memory GB": round(memory / 1e3, 2),
        "start s": round(start, 1),
    }


if __name__ == "__main__":
    print(json.dumps(_measure(int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))))
