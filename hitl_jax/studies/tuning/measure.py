"""How a configuration is measured: every run of it is trained, and tested at the end."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hitl_jax.config import Method, hyper_for
from hitl_jax.envs import make_pool
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import evaluate_runs
from hitl_jax.results.episode_measures import FALL_REWARD
from hitl_jax.studies.tuning.options import STAGES, TuningOptions
from hitl_jax.sweep.changes import Parts
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import FinishedRun, Run, RunSpec, num_slots

_LAST_EPISODES = 10


def measure(
    parts: Parts, options: TuningOptions, tell: Callable[[dict[str, Any]], None]
) -> tuple[list[dict[str, Any]], dict[str, list[float]]]:
    """Trains and tests every run of one configuration.

    Args:
        parts: the configuration.
        options: seeds and budget.
        tell: is given each stage as it ends.

    Returns:
        Training returns after each third of the ticks, with the seconds since the warm-up ended;
        mean test return of each run.
    """
    config, loop, hyper, _ = parts
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
            if ticks * STAGES >= options.ticks * (len(stages) + 1):
                returns = _returns(rollout.runs(), lost)
                stages.append({"ticks": ticks, "seconds": time.monotonic() - started, **returns})
                tell(stages[-1])
            if ticks >= options.ticks:
                break
        else:  # All have diverged.
            seconds = time.monotonic() - started
            end = {"ticks": ticks, "seconds": seconds, **_returns([], lost)}
            stages += [end] * (STAGES - len(stages))
        examiner = HostExaminer(agent, test_pool)
        left = [rollout.collect(run) for run in rollout.runs() if not run.done]
        ended = [*left, *lost]
        told = evaluate_runs(examiner, ended, lambda _: ("autonomous",))
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
