"""The whole loop: rates, compiled programs and memory over time."""

import math
import time

import jax

from experiments.benchmarks.timing import REPEATS, Row, memory_mb
from hitl_jax import batch
from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import make_pool
from hitl_jax.rollout import LoopConfig, Rollout, RunSpec

COMPILED = "backend_compile_duration"
"""End of the name of the event that JAX reports for each program that XLA compiles."""


def measure_loop(seconds: float) -> list[Row]:
    """The whole loop at its defaults: rates, compiled programs and memory over time."""
    config = LoopConfig(capacity=20_000)
    agent = make_agent(AgentConfig())
    hyper = Hyper(warmup_steps=500)
    specs = [
        RunSpec(method, seed, hyper_for(method, hyper), 10**6)
        for seed in range(10)
        for method in Method
    ]
    rows: list[Row] = []
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if event.endswith(COMPILED) else None
    )
    devices = batch.make_mesh().size
    slots = math.ceil(len(specs) / devices) * devices
    with make_pool("lean", slots, None) as pool:
        rollout = Rollout(agent, specs, pool, config)
        chunks = iter(rollout)
        for _ in range(2 * (hyper.warmup_steps // config.chunk + 2)):
            next(chunks)
        for part in range(REPEATS):
            start, ticks = time.perf_counter(), 0
            while time.perf_counter() - start < 2 * seconds:
                next(chunks)
                ticks += config.chunk
            rate = ticks * len(specs) / (time.perf_counter() - start)
            rows.append(
                {
                    "part": part + 1,
                    "runs": len(specs),
                    "steps/s": round(rate),
                    "updates/s": round(rate * config.updates_per_step),
                    "programs compiled": len(compiled),
                    "memory MB": round(memory_mb()),
                }
            )
    return rows
