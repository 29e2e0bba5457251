"""What a researcher would use instead, side by side: SBX's TD3, and other ways to step walkers.

SBX plays and learns one run a process: one process; one a core, as they are started; the same, each
kept to its core; and these with sixteen updates after sixteen steps, which it compiles into one
call. We play 30 runs of the same network (no normalisation), batch, n and update ratio, on the
official walker and on the lean one, and there also with hidden layers multiplied in bfloat16, for
which SBX has no option (JAX's own setting does not change what XLA compiles for a CPU). The bar is
for float32. What still differs: SBX moves its targets at every update, we at every second, and its
actor follows the lesser of both critics, ours the first, as in TD3.
"""

import importlib.metadata
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from threading import Barrier

import numpy as np

from hitl_jax.benchmarks.loop import WARMUP_STEPS, play, specs_of, warm_up
from hitl_jax.benchmarks.pool import WALKERS, plain_rate, pool_rate
from hitl_jax.config import LAST, AgentConfig, Method
from hitl_jax.envs import WALKER, make_pool
from hitl_jax.results.episode_measures import Row
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, num_slots
from hitl_jax.xla.cores import num_cores

RUNS = 30
TOGETHER = 16
"""Updates in one compiled call, ours and SBX's."""

TURNS = 3
"""Times that each is measured, all in turn."""

START_SECONDS = 300.0
VECTOR_WALKERS = 16
"""Walkers of AsyncVectorEnv: it starts a process for each."""

_SIZES = ((128, 128, 3.0), (256, 256, 1.7))
"""Width, batch, and the bar: our rate as a multiple of SBX's in processes as they are started."""

_Way = tuple[str, str, Callable[[float], float]]
"""Name, package, and what measures its rate in some seconds."""


def measure_peers(seconds: float) -> list[Row]:
    """Environment steps/s of each, all runs together; ours as multiples of others'."""
    cores = num_cores()
    rows: list[Row] = []
    for width, batch_size, bar in _SIZES:
        learner = f"[{width}, {width}], batch {batch_size}"
        sbx = partial(_sbx, width, batch_size)
        ours = partial(_ours, width, batch_size)
        reference = f"SBX TD3 {learner}, {cores} processes"
        us = f"hitl_jax {learner}"
        rows += compared(
            [
                (f"SBX TD3 {learner}, one process", "sbx-rl", partial(sbx, 1, 1, False)),
                (reference, "sbx-rl", partial(sbx, cores, 1, False)),
                (f"{reference}, a core each", "sbx-rl", partial(sbx, cores, 1, True)),
                (f"{reference}, a core each, by 16", "sbx-rl", partial(sbx, cores, TOGETHER, True)),
                (f"{us}, official walker", "hitl_jax", partial(ours, "gymnasium", "float32")),
                (f"{us}, bfloat16", "hitl_jax", partial(ours, "lean", "bfloat16")),
                (us, "hitl_jax", partial(ours, "lean", "float32")),
            ],
            reference,
            5 * seconds,
            bar,
        )
    rows += compared(
        [
            ("gymnasium, plain loop", "gymnasium", partial(plain_rate, 1, WALKERS)),
            (f"gymnasium AsyncVectorEnv of {VECTOR_WALKERS}", "gymnasium", _vector),
            (f"EnvPool, {cores} threads", "envpool", _envpool),
            (f"hitl_jax lean, {cores} workers", "hitl_jax", partial(pool_rate, "lean", cores)),
        ],
        f"EnvPool, {cores} threads",
        seconds,
        bar=0.8,
    )
    return rows


def compared(ways: list[_Way], reference: str, seconds: float, bar: float) -> list[Row]:
    """Measures `ways` in turns, medians; ours as multiples of `reference` and of the best other.

    A multiple is the median of those of the turns: a machine's speed changes from turn to turn.
    The bar is the last way's.
    """
    rates: dict[str, list[float]] = {name: [] for name, *_ in ways}
    rows: dict[str, Row] = {name: {"peer": name} for name, *_ in ways}
    for _ in range(TURNS):
        for name, package, measure in ways:
            try:
                rows[name]["version"] = importlib.metadata.version(package)
                rates[name].append(measure(seconds))
            except ImportError as error:
                rows[name]["peer"] = f'{name}: missing ({error}); pip install -e ".[bench]"'
    others = [rates[name] for name, package, _ in ways if package != "hitl_jax" and rates[name]]
    best = [max(turn) for turn in zip(*others, strict=True)]
    for name, package, _ in ways:
        if rates[name]:
            rows[name]["steps/s"] = round(statistics.median(rates[name]))
            if package == "hitl_jax" and others:
                if rates[reference]:
                    rows[name]["ratio"] = _multiple(rates[name], rates[reference])
                rows[name]["to the best"] = _multiple(rates[name], best)
    rows[ways[-1][0]]["bar"] = bar
    return list(rows.values())


def _multiple(ours: list[float], others: list[float]) -> float:
    each = [one / other for one, other in zip(ours, others, strict=True)]
    return round(statistics.median(each), 2)


def _sbx(
    width: int, batch_size: int, processes: int, together: int, pinned: bool, seconds: float
) -> float:
    """Steps/s of SBX in some processes at once, `together` updates after as many steps."""
    import sbx  # noqa: F401, a missing peer is named before processes start

    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(processes, context) as executor:
        ready = manager.Barrier(processes, timeout=START_SECONDS)
        jobs = [
            executor.submit(
                _sbx_steps,
                ready,
                index if pinned else None,
                width,
                batch_size,
                together,
                seconds,
            )
            for index in range(processes)
        ]
        return sum(job.result() for job in jobs)


def _sbx_steps(
    ready: Barrier, core: int | None, width: int, batch_size: int, together: int, seconds: float
) -> float:
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[core]})
    import gymnasium
    import sbx
    from stable_baselines3.common.callbacks import BaseCallback

    class Until(BaseCallback):
        deadline = 0.0

        def _on_step(self) -> bool:
            return time.perf_counter() < self.deadline

    model = sbx.TD3(
        "MlpPolicy",
        gymnasium.make(WALKER, disable_env_checker=True),
        policy_kwargs={"net_arch": [width, width]},
        batch_size=batch_size,
        buffer_size=LoopConfig().capacity,
        learning_starts=WARMUP_STEPS,
        train_freq=together,
        gradient_steps=together,
    )
    model.learn(2 * WARMUP_STEPS)  # Compiles.
    ready.wait()
    until = Until()
    start, before = time.perf_counter(), model.num_timesteps
    until.deadline = start + seconds
    model.learn(10**9, callback=until, reset_num_timesteps=False)
    steps: int = model.num_timesteps - before
    return steps / (time.perf_counter() - start)


def _ours(width: int, batch_size: int, backend: str, precision: str, seconds: float) -> float:
    """Steps/s of the whole loop, SRL, the method that SBX's is."""
    config = AgentConfig(
        learner="td3",
        human_data="transitions",
        tested_actor=LAST,
        hidden_sizes=(width, width),
        batch_size=batch_size,
        n_step=1,
        layer_norm=False,
        matmul_precision=precision,
    )
    loop = LoopConfig(chunk=TOGETHER, updates_per_step=1.0)
    with make_pool(backend, num_slots(RUNS, RUNS)) as pool:
        rollout = Rollout(make_agent(config), specs_of([Method.SRL], RUNS), pool, loop)
        chunks = iter(rollout)
        warm_up(rollout, chunks)
        played = play(rollout, chunks, seconds)
        return played.steps / played.seconds


def _vector(seconds: float) -> float:
    """Steps/s of gymnasium's own vector of processes."""
    import gymnasium

    makers = [lambda: gymnasium.make(WALKER, disable_env_checker=True)] * VECTOR_WALKERS
    walkers = gymnasium.vector.AsyncVectorEnv(makers, context="spawn")
    try:
        walkers.reset(seed=0)
        return _random_steps(walkers.step, VECTOR_WALKERS, seconds)
    finally:
        walkers.close()


def _envpool(seconds: float) -> float:
    """Steps/s of EnvPool by itself."""
    import envpool

    walkers = envpool.make_gymnasium(WALKER, num_envs=WALKERS, num_threads=num_cores())
    walkers.reset()
    return _random_steps(walkers.step, WALKERS, seconds)


def _random_steps(step: Callable[[np.ndarray], object], walkers: int, seconds: float) -> float:
    rng = np.random.default_rng(0)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        step(rng.uniform(-1, 1, (walkers, 4)).astype(np.float32))
        steps += walkers
    return steps / (time.perf_counter() - start)
