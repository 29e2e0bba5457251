"""What a researcher would use instead, side by side: SBX's TD3, and other ways to step walkers.

SBX plays and learns one run a process: it is measured in one process and in two at once. We play 30
runs of the same network, batch and update ratio. Rates are environment steps of all runs together.
"""

import importlib.metadata
import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from threading import Barrier

import numpy as np

from experiments.benchmarks.pool import WALKERS, WORKERS, plain_rate, pool_rate
from experiments.benchmarks.timing import Row
from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import WALKER, make_pool
from hitl_jax.rollout import LoopConfig, Rollout, RunSpec, num_slots

RUNS = 30
WARMUP_STEPS = 500
START_SECONDS = 300.0
VECTOR_WALKERS = 16
"""Walkers of AsyncVectorEnv: it starts a process for each."""

_SIZES = ((128, 128, 3.0), (256, 256, 1.7))
"""Width, batch, and how many times SBX's rate in two processes ours must be."""

_Way = tuple[str, str, Callable[[float], float]]
"""Name, package, and what measures its rate in some seconds."""


def measure_peers(seconds: float) -> list[Row]:
    """Steps/s of each; `ratio` is ours to the row above it, and says which bar it has."""
    rows: list[Row] = []
    for width, batch_size, bar in _SIZES:
        learner = f"[{width}, {width}], batch {batch_size}, 1 update a step"
        ways: list[_Way] = [
            (f"SBX TD3 {learner}, one process", "sbx-rl", partial(_sbx, 1, width, batch_size)),
            (f"SBX TD3 {learner}, two processes", "sbx-rl", partial(_sbx, 2, width, batch_size)),
            (f"hitl_jax {learner}, {RUNS} runs", "hitl_jax", partial(_ours, width, batch_size)),
        ]
        rows += _rows(ways, 5 * seconds, ratio_to=1, bar=bar)
    ways = [
        ("gymnasium, plain loop", "gymnasium", partial(plain_rate, 1, WALKERS)),
        (f"gymnasium AsyncVectorEnv, {VECTOR_WALKERS} walkers", "gymnasium", _vector),
        ("EnvPool, two threads", "envpool", partial(pool_rate, "envpool")),
        (f"hitl_jax lean, {WORKERS} workers", "hitl_jax", partial(pool_rate, "lean")),
    ]
    rows += _rows(ways, seconds, ratio_to=2, bar=0.8)
    return rows


def _rows(ways: list[_Way], seconds: float, ratio_to: int, bar: float) -> list[Row]:
    """Measures `ways`; the last is ours and is compared with the one at `ratio_to`."""
    rows: list[Row] = []
    for name, package, measure in ways:
        row: Row = {"peer": name}
        try:
            row["version"] = importlib.metadata.version(package)
            row["steps/s"] = round(measure(seconds))
        except ImportError as error:
            row["peer"] += f': missing ({error}); pip install -e ".[bench]"'
        rows.append(row)
    rows[-1]["bar"] = bar
    if "steps/s" in rows[ratio_to]:
        rows[-1]["ratio"] = round(rows[-1]["steps/s"] / rows[ratio_to]["steps/s"], 2)
    return rows


def _sbx(processes: int, width: int, batch_size: int, seconds: float) -> float:
    """Steps/s of SBX in some processes at once."""
    import sbx  # noqa: F401, a missing peer is named before processes start

    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(processes, context) as executor:
        ready = manager.Barrier(processes, timeout=START_SECONDS)
        jobs = [
            executor.submit(_sbx_steps, ready, width, batch_size, seconds) for _ in range(processes)
        ]
        return sum(job.result() for job in jobs)


def _sbx_steps(ready: Barrier, width: int, batch_size: int, seconds: float) -> float:
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
        train_freq=1,
        gradient_steps=1,
    )
    model.learn(2 * WARMUP_STEPS)  # Compiles both kinds of update.
    ready.wait()
    until = Until()
    start, before = time.perf_counter(), model.num_timesteps
    until.deadline = start + seconds
    model.learn(10**9, callback=until, reset_num_timesteps=False)
    steps: int = model.num_timesteps - before
    return steps / (time.perf_counter() - start)


def _ours(width: int, batch_size: int, seconds: float) -> float:
    """Run-steps/s of the whole loop, SRL, the method that SBX's is."""
    agent = make_agent(AgentConfig(hidden_sizes=(width, width), batch_size=batch_size, n_step=1))
    config = LoopConfig(updates_per_step=1.0)
    hyper = hyper_for(Method.SRL, Hyper(warmup_steps=WARMUP_STEPS))
    specs = [RunSpec(Method.SRL, seed, hyper, 10**6) for seed in range(RUNS)]
    with make_pool("lean", num_slots(RUNS, RUNS), WORKERS) as pool:
        chunks = iter(Rollout(agent, specs, pool, config))
        for _ in range(2 * WARMUP_STEPS // config.chunk):
            next(chunks)
        ticks, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds:
            next(chunks)
            ticks += config.chunk
        return ticks * RUNS / (time.perf_counter() - start)


def _vector(seconds: float) -> float:
    """Steps/s of gymnasium's own vector of processes."""
    import gymnasium

    rng = np.random.default_rng(0)
    makers = [lambda: gymnasium.make(WALKER, disable_env_checker=True)] * VECTOR_WALKERS
    walkers = gymnasium.vector.AsyncVectorEnv(makers, context="spawn")
    try:
        walkers.reset(seed=0)
        steps, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds:
            walkers.step(rng.uniform(-1, 1, (VECTOR_WALKERS, 4)).astype(np.float32))
            steps += VECTOR_WALKERS
        return steps / (time.perf_counter() - start)
    finally:
        walkers.close()
