"""What a learner's configuration costs and gives: `hitl-jax tuning`.

Every configuration gets the same ticks (environment steps, and a tick for each reset), seeds and
methods; the seeds are none of those that a sweep reports. What is done is kept, and skipped when
the command is given again.
"""

import dataclasses
import json
import pathlib
import time
from typing import Annotated, Any

import msgspec
import numpy as np
import tyro

from hitl_jax.analysis import markdown
from hitl_jax.choices.checks import require_seeds, require_whole
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.console.cli import checking_input
from hitl_jax.envs import make_pool, require_backend
from hitl_jax.errors import BadInput
from hitl_jax.evaluation.host import Evaluator
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES, evaluate_runs
from hitl_jax.results import atomic_files
from hitl_jax.results.config_diff import completed
from hitl_jax.results.episode_measures import FALL_REWARD
from hitl_jax.results.json_documents import checked, options_of, plain_from_json
from hitl_jax.results.provenance import git_commit, short_commit
from hitl_jax.results.schemas import Config, Count, Positive, Text
from hitl_jax.studies.changes import Changes, changed
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import FinishedRun, LoopConfig, Run, RunSpec, num_slots

_BASE: Changes = {
    "learner": "td3",
    "hidden_sizes": (128, 128),
    "layer_norm": False,
    "batch_size": 128,
    "n_step": 4,
    "updates_per_step": 0.5,
    "noise_free_every": 0,
    "exploration_noise": 0.2,
}

_NORM: Changes = {"batch_size": 64, "layer_norm": True}
_QUIET: Changes = _NORM | {"noise_free_every": 4}
_TQC: Changes = _QUIET | {"learner": "td3-tqc"}
_SLOW: Changes = {"actor_learning_rate": 5e-4, "critic_learning_rate": 5e-4}

CONFIGURATIONS: dict[str, Changes] = {
    "128-batch-128": {},
    "128-batch-64": {"batch_size": 64},
    "128-batch-64-norm": _NORM,
    "128-batch-64-norm-quiet": _QUIET,
    "64-batch-64-norm-quiet": _QUIET | {"hidden_sizes": (64, 64)},
    "128-batch-64-norm-quiet-lr-5e-4": _QUIET | _SLOW,
    "128-batch-64-norm-quiet-n-8": _QUIET | {"n_step": 8},
    "128-batch-64-norm-quiet-tqc": _TQC,
    "128-batch-64-norm-quiet-tqc-noise-0.3": _TQC | {"exploration_noise": 0.3},
    "128-batch-64-norm-quiet-tqc-quarter": _TQC | {"updates_per_step": 0.25},
}
"""What each configuration changes of `_BASE`, by the names of the options."""

_STAGES = 3
_LAST_EPISODES = 10


@dataclasses.dataclass(frozen=True)
class TuningOptions:
    """Train the three methods with several learners and compare return with time.

    Attributes:
        configurations: some of 128-batch-128, 128-batch-64, 128-batch-64-norm,
            128-batch-64-norm-quiet, 64-batch-64-norm-quiet, 128-batch-64-norm-quiet-lr-5e-4,
            128-batch-64-norm-quiet-n-8, 128-batch-64-norm-quiet-tqc,
            128-batch-64-norm-quiet-tqc-noise-0.3, 128-batch-64-norm-quiet-tqc-quarter (hidden
            units, minibatch, what else; `quiet` plays every fourth training episode without action
            noise, `quarter` makes one update in four ticks).
        seeds: number of seeds for each method.
        first_seed: the first of them; a sweep reports others.
        ticks: ticks of a run: environment steps and resets.
        test_episodes: autonomous test episodes of a run.
        out: folder of the results, a file a configuration and a table of those of equal budget.
    """

    configurations: Annotated[tuple[str, ...], tyro.conf.arg(name="only")] = tuple(CONFIGURATIONS)
    seeds: int = 5
    first_seed: int = 100
    ticks: int = 200_000
    test_episodes: int = 20
    out: str = "runs/tuning"


def main(options: TuningOptions) -> int:
    """Runs the configurations that are not done yet; prints and writes the table of all."""
    out = pathlib.Path(options.out)
    with checking_input():
        _check(options)
        try:
            out.mkdir(parents=True, exist_ok=True)
            atomic_files.write_text_atomic(out / "tuning.md", table(out, options))
        except OSError as error:
            raise BadInput(f"--out {options.out}: {error.strerror}") from error
    keep_programs()
    for name in options.configurations:
        agent, loop, hyper, _ = changed(_BASE | CONFIGURATIONS[name])
        asked = {
            "budget": _budget(options),
            "agent": dataclasses.asdict(agent),
            "loop": dataclasses.asdict(loop),
            "hyper": dataclasses.asdict(hyper),
        }
        asked = json.loads(json.dumps(asked))  # as it will be read back
        path = out / f"{name}.json"
        if (known := _load(path)) is not None and completed(known["asked"]) == asked:
            continue
        with checking_input():
            require_backend("lean")
        stages, tests = _measure(name, agent, loop, hyper, options)
        done = {"asked": asked, "commit": git_commit(), "stages": stages, "tests": tests}
        atomic_files.write_text_atomic(path, json.dumps(done, indent=1, allow_nan=False) + "\n")
        atomic_files.write_text_atomic(out / "tuning.md", table(out, options))
    print(table(out, options))
    return 0


def _check(options: TuningOptions) -> None:
    """Raises ValueError with one line for options that cannot be run."""
    unknown = [name for name in options.configurations if name not in CONFIGURATIONS]
    if unknown or not options.configurations:
        given = " ".join(options.configurations) or "(none)"
        raise ValueError(f"--only {given}: must be some of {', '.join(CONFIGURATIONS)}")
    require_seeds(options.first_seed, options.seeds)
    require_whole("test_episodes", options.test_episodes, 1, MOST_TEST_EPISODES)
    require_whole("ticks", options.ticks, at_least=_STAGES * LoopConfig().chunk)


def _budget(options: TuningOptions) -> dict[str, int]:
    """What must be equal for two configurations to be compared."""
    names = ("seeds", "first_seed", "ticks", "test_episodes")
    return {name: getattr(options, name) for name in names}


def _measure(
    name: str, config: AgentConfig, loop: LoopConfig, hyper: Hyper, options: TuningOptions
) -> tuple[list[dict[str, Any]], dict[str, list[float]]]:
    """Trains and tests every run of one configuration.

    Returns:
        Training returns after each third of the ticks, with the seconds since the warm-up ended;
        mean test return of each run.
    """
    agent = make_agent(config)
    specs = [
        RunSpec(method, seed, hyper_for(method, hyper), episodes=options.ticks)
        for seed in range(options.first_seed, options.first_seed + options.seeds)
        for method in Method
    ]
    stages: list[dict[str, Any]] = []
    tests: dict[str, list[float]] = {method: [] for method in Method}
    with (
        make_pool("lean", num_slots(len(specs), len(specs))) as pool,
        make_pool("lean", options.test_episodes) as test_pool,
    ):
        rollout = Rollout(agent, specs, pool, loop)
        started = time.monotonic()
        lost: list[FinishedRun] = []  # They diverged: no run has as many episodes as ticks.
        for number, done in enumerate(rollout, start=1):
            lost += done
            ticks = number * loop.chunk
            if ticks <= hyper.warmup_steps:
                started = time.monotonic()
            if ticks * _STAGES >= options.ticks * (len(stages) + 1):
                returns = _returns(rollout.runs(), lost)
                stages.append({"ticks": ticks, "seconds": time.monotonic() - started, **returns})
                print(name, json.dumps(stages[-1]), flush=True)
            if ticks >= options.ticks:
                break
        else:  # All have diverged.
            seconds = time.monotonic() - started
            end = {"ticks": ticks, "seconds": seconds, **_returns([], lost)}
            stages += [end] * (_STAGES - len(stages))
        evaluator = Evaluator(agent, test_pool)
        left = [rollout.collect(run) for run in rollout.runs() if not run.done]
        ended = [*left, *lost]
        told = evaluate_runs(evaluator, ended, lambda _: ("autonomous",))
        for run, (rows, _) in zip(ended, told, strict=True):
            tests[run.run.spec.method].append(float(np.mean([row["return"] for row in rows])))
    return stages, tests


def _returns(runs: list[Run], lost: list[FinishedRun]) -> dict[str, list[float]]:
    """Mean of the latest training returns of each run that has one, by method; falls if lost."""
    latest: dict[str, list[float]] = {method: [] for method in Method}
    for run in runs:
        if run.episodes and not run.done:
            returns = [row["return"] for row in run.episodes[-_LAST_EPISODES:]]
            latest[run.spec.method].append(float(np.mean(returns)))
    for finished in lost:
        latest[finished.run.spec.method].append(FALL_REWARD)
    return latest


def _load(path: pathlib.Path) -> dict[str, Any] | None:
    """What this command has written to a file; None where it has not."""
    try:
        data: dict[str, Any] = plain_from_json(atomic_files.read_bytes(path), dict[str, Any])
        checked(data, _Tuned)
        for name, kind in (("agent", AgentConfig), ("loop", LoopConfig), ("hyper", Hyper)):
            options_of(completed(data["asked"])[name], kind)
    except ValueError:
        return None
    return data


_Measured = Annotated[float, msgspec.Meta(ge=-1e30, le=1e30)]


class _Budget(msgspec.Struct):
    seeds: Positive
    first_seed: Count
    ticks: Positive
    test_episodes: Positive


class _Asked(msgspec.Struct):
    budget: _Budget
    agent: Config
    loop: Config
    hyper: Config


class _Stage(msgspec.Struct, rename="kebab"):
    ticks: Positive
    seconds: Annotated[float, msgspec.Meta(gt=0.0)]
    srl: list[_Measured]
    hitl_fix: list[_Measured]
    hitl_ac: list[_Measured]


_Returns = Annotated[list[_Measured], msgspec.Meta(min_length=1)]


class _Tests(msgspec.Struct, rename="kebab"):
    srl: _Returns
    hitl_fix: _Returns
    hitl_ac: _Returns


class _Tuned(msgspec.Struct):
    """What is written of a configuration."""

    asked: _Asked
    commit: Text | None
    stages: Annotated[list[_Stage], msgspec.Meta(min_length=1)]
    tests: _Tests


def table(out: pathlib.Path, options: TuningOptions) -> str:
    """Markdown: a row for each configuration in the folder that had the same budget.

    Args:
        out: the folder.
        options: the budget.
    """
    head = ["configuration", "commit", "ticks/s, all runs"]
    for method in Method:
        head += [f"{method}: training by thirds", f"{method}: test (least to most)"]
    lines = [head]
    for path in sorted(out.glob("*.json")):
        data = _load(path)
        if data is None or data["asked"]["budget"] != _budget(options):
            continue
        warmup = data["asked"]["hyper"]["warmup_steps"]
        last, runs = data["stages"][-1], sum(map(len, data["tests"].values()))
        rate = max(last["ticks"] - warmup, 0) * runs / last["seconds"]
        row = [path.stem, short_commit(data["commit"]), f"{rate:,.0f}"]
        for method in Method:
            tests = data["tests"][method]
            thirds = [stage[method] for stage in data["stages"]]
            row.append(", ".join(f"{np.mean(third):.0f}" if third else "–" for third in thirds))
            row.append(f"{np.mean(tests):.0f} ({min(tests):.0f} to {max(tests):.0f})")
        lines.append(row)
    return markdown.table(lines)
