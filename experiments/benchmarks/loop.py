"""The whole loop beside its bound: what learner and walkers need when each has the cores alone."""

import math
import time
from typing import Any

import jax
import numpy as np

from experiments.benchmarks.learner import learner_rate
from experiments.benchmarks.timing import REPEATS, Row, memory_mb
from hitl_jax import batch
from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import StepBatch, WalkerPool, make_pool
from hitl_jax.rollout import CPU_TILE, LoopConfig, Rollout, RunSpec

COMPILED = "backend_compile_duration"
"""End of the name of the event that JAX reports for each program that XLA compiles."""

BAR = 0.9

_Tick = tuple[np.ndarray, np.ndarray, np.ndarray]


def measure_loop(seconds: float) -> list[Row]:
    """Rates, compiled programs and memory over time, at the defaults.

    The bound of a stretch is the time that its updates take alone and its ticks take alone, each
    with all cores: acting, bookkeeping and waiting are what is lost.
    """
    config = LoopConfig(capacity=20_000)
    agent = make_agent(AgentConfig())
    hyper = Hyper(warmup_steps=500)
    specs = [
        RunSpec(method, seed, hyper_for(method, hyper), 10**6)
        for seed in range(10)
        for method in Method
    ]
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if event.endswith(COMPILED) else None
    )
    devices = batch.make_mesh().size
    slots = math.ceil(len(specs) / devices) * devices
    rows: list[Row] = []
    with make_pool("lean", slots) as inner, make_pool("lean", slots) as again:
        pool = _Recorded(inner)
        rollout = Rollout(agent, specs, pool, config)
        chunks = iter(rollout)
        for _ in range(2 * (hyper.warmup_steps // config.chunk + 2)):
            next(chunks)
        _replay(again, pool.ticks)
        for part in range(REPEATS):
            programs = len(compiled)
            start, ticks = time.perf_counter(), 0
            while time.perf_counter() - start < 2 * seconds:
                next(chunks)
                ticks += config.chunk
            took = time.perf_counter() - start
            programs = len(compiled) - programs
            walking = _replay(again, pool.ticks)
            num_updates = config.num_updates(agent.config.policy_delay)
            rate = learner_rate(agent.config, slots, num_updates, seconds, CPU_TILE)
            learning = ticks * config.updates_per_step * len(specs) / rate
            rows.append(
                {
                    "part": part + 1,
                    "runs": len(specs),
                    "steps/s": round(ticks * len(specs) / took),
                    "updates/s": round(ticks * len(specs) * config.updates_per_step / took),
                    "learner s": round(learning, 2),
                    "walkers s": round(walking, 2),
                    "loop s": round(took, 2),
                    "share of bound": round((learning + walking) / took, 3),
                    "bar": BAR,
                    "programs compiled": programs,
                    "memory MB": round(memory_mb()),
                }
            )
    return rows


class _Recorded:
    """A pool that remembers what it was told, until that is replayed."""

    def __init__(self, pool: WalkerPool):
        self._pool = pool
        self.ticks: list[_Tick] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._pool, name)

    def step(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> StepBatch:
        self.ticks.append((command.copy(), action.copy(), seed.copy()))
        return self._pool.step(command, action, seed)


def _replay(pool: WalkerPool, ticks: list[_Tick]) -> float:
    """Seconds that a pool of the same walkers takes for the same ticks; forgets them."""
    start = time.perf_counter()
    for tick in ticks:
        pool.step(*tick)
    took = time.perf_counter() - start
    ticks.clear()
    return took
