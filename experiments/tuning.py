"""What a learner's configuration costs and gives: `python -m experiments.tuning`.

Every configuration gets the same environment steps, seeds and methods; the seeds are none of those
that a sweep reports. What is done is kept, and skipped when the command is given again.
"""

import dataclasses
import json
import pathlib
import sys
import time
from typing import Annotated, Any

import numpy as np
import tyro

from experiments.cli import BadInput, checking_input, run_main
from experiments.devices import keep_programs, use_all_cores
from hitl_jax import files
from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for, require
from hitl_jax.envs import make_pool
from hitl_jax.evaluation import Evaluator, evaluate_run
from hitl_jax.rollout import CPU_TILE, LoopConfig, Rollout, Run, RunSpec, num_slots

_Changes = dict[str, Any]

_BASE: _Changes = {
    "hidden_sizes": (128, 128),
    "layer_norm": False,
    "batch_size": 128,
    "n_step": 4,
    "updates_per_step": 0.5,
}

CONFIGURATIONS: dict[str, _Changes] = {
    "64-batch-128": {"hidden_sizes": (64, 64)},
    "64-batch-128-ratio-1": {"hidden_sizes": (64, 64), "updates_per_step": 1.0},
    "64-batch-128-n-8": {"hidden_sizes": (64, 64), "n_step": 8},
    "128-batch-128": {},
    "64-batch-64-ratio-1": {"hidden_sizes": (64, 64), "batch_size": 64, "updates_per_step": 1.0},
    "128-batch-64": {"batch_size": 64},
    "128-batch-64-norm": {"batch_size": 64, "layer_norm": True},
}
"""What each configuration changes of `_BASE`, by the names of the options."""

_STAGES = 3
_LAST_EPISODES = 10


@dataclasses.dataclass(frozen=True)
class TuningOptions:
    """Train the three methods with several learners and compare return with time.

    Attributes:
        configurations: which of those named in this module.
        seeds: number of seeds for each method.
        first_seed: the first of them; a sweep reports others.
        steps: environment steps of a run.
        test_episodes: autonomous test episodes of a run.
        out: folder of the results, a file a configuration and a table of all.
    """

    configurations: Annotated[tuple[str, ...], tyro.conf.arg(name="only")] = tuple(CONFIGURATIONS)
    seeds: int = 5
    first_seed: int = 100
    steps: int = 150_000
    test_episodes: int = 20
    out: str = "runs/tuning"


def main(options: TuningOptions) -> int:
    """Runs the configurations that are not done yet; prints and writes the table of all."""
    with checking_input():
        unknown = [name for name in options.configurations if name not in CONFIGURATIONS]
        if unknown or not options.configurations:
            given = " ".join(options.configurations) or "(none)"
            raise BadInput(f"--only {given}: must be some of {', '.join(CONFIGURATIONS)}")
        for name in ("seeds", "steps", "test_episodes"):
            require(name, getattr(options, name), at_least=1)
        require("first_seed", options.first_seed, at_least=0)
    out = pathlib.Path(options.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"--out {options.out}: {error.strerror}") from error
    use_all_cores()
    keep_programs()
    for name in options.configurations:
        path = out / f"{name}.json"
        asked = dataclasses.asdict(dataclasses.replace(options, configurations=(name,)))
        if path.exists() and json.loads(path.read_text())["asked"] == asked:
            continue
        measured = {"asked": asked, **_measure(name, options)}
        files.write_text_atomic(path, json.dumps(measured, indent=1) + "\n")
        files.write_text_atomic(out / "tuning.md", _table(out))
    print(_table(out))
    return 0


def _measure(name: str, options: TuningOptions) -> dict[str, Any]:
    """Trains and tests every run of one configuration."""
    changes = _BASE | CONFIGURATIONS[name]
    agent = make_agent(_with(AgentConfig(), changes))
    loop = _with(LoopConfig(), changes)
    hyper = _with(Hyper(), changes)
    specs = [
        RunSpec(method, seed, hyper_for(method, hyper), episodes=options.steps)
        for seed in range(options.first_seed, options.first_seed + options.seeds)
        for method in Method
    ]
    stages: list[dict[str, Any]] = []
    with (
        make_pool("lean", num_slots(len(specs), len(specs))) as pool,
        make_pool("lean", options.test_episodes) as test_pool,
    ):
        rollout = Rollout(agent, specs, pool, loop, CPU_TILE)
        started = time.monotonic()
        for number, _ in enumerate(rollout, start=1):
            ticks = number * loop.chunk
            if ticks * _STAGES >= options.steps * (len(stages) + 1):
                seconds = time.monotonic() - started
                stages.append({"ticks": ticks, "seconds": seconds, **_returns(rollout.runs())})
                print(name, json.dumps(stages[-1]), flush=True)
            if ticks >= options.steps:
                break
        evaluator = Evaluator(agent, test_pool)
        tests: dict[str, list[float]] = {method: [] for method in Method}
        for run in rollout.runs():
            rows = evaluate_run(
                evaluator, rollout.collect(run), options.test_episodes, ("autonomous",)
            )
            tests[run.spec.method].append(float(np.mean([row["return"] for row in rows])))
    return {"changes": changes, "stages": stages, "tests": tests}


def _with(config: Any, changes: _Changes) -> Any:
    names = {field.name for field in dataclasses.fields(config)}
    return dataclasses.replace(config, **{k: v for k, v in changes.items() if k in names})


def _returns(runs: list[Run]) -> dict[str, list[float]]:
    """Mean of each run's latest training returns, by method."""
    return {
        method: [
            float(np.mean([row["return"] for row in run.episodes[-_LAST_EPISODES:]]))
            for run in runs
            if run.spec.method == method
        ]
        for method in Method
    }


def _table(out: pathlib.Path) -> str:
    """Markdown: a row for each configuration in the folder."""
    head = ["configuration", "run-steps/s", "minutes"]
    for method in Method:
        head += [f"{method}: training by thirds", f"{method}: test"]
    lines = [head, ["---"] * len(head)]
    for path in sorted(out.glob("*.json")):
        data = json.loads(path.read_text())
        last = data["stages"][-1]
        runs = sum(len(values) for values in data["tests"].values())
        row = [path.stem, f"{last['ticks'] * runs / last['seconds']:,.0f}"]
        row.append(f"{last['seconds'] / 60:.1f}")
        for method in Method:
            tests = data["tests"][method]
            row.append(", ".join(f"{np.mean(stage[method]):.0f}" for stage in data["stages"]))
            row.append(f"{np.mean(tests):.0f} ({min(tests):.0f} to {max(tests):.0f})")
        lines.append(row)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    sys.exit(run_main(TuningOptions, main))
