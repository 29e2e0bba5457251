"""The whole loop beside its bound, the busy time of learner and walkers over the cores.

Busy time is told in two ways: as core time of the learner's threads and of the walkers' processes
while the loop runs, as a share of what the machine's host left of the cores, and, stricter, as what
the same updates and ticks take with all cores to themselves, where neither takes the other's cache.
"""

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from hitl_jax.benchmarks.learner import make_learner
from hitl_jax.benchmarks.timing import REPEATS, best, busy_seconds, memory_mb, stolen_seconds
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import StepBatch, WalkerPool, make_pool
from hitl_jax.results.episode_measures import Row
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec, num_slots
from hitl_jax.xla.cores import num_cores

COMPILED = "backend_compile_duration"
"""End of the name of the event that JAX reports for each program that XLA compiles."""

RUNS = 30
WARMUP_STEPS = 500
BAR = 0.9

_Tick = tuple[np.ndarray, np.ndarray, np.ndarray]


class Played(NamedTuple):
    """What a stretch of the loop did.

    Attributes:
        ticks: of every run.
        steps: environment steps of all runs together; a tick that resets a walker is none.
        seconds: until the last update of the stretch was done.
        busy: core time of learner and walkers [s].
        stolen: core time that other virtual machines took meanwhile [s].
    """

    ticks: int
    steps: int
    seconds: float
    busy: float
    stolen: float


def specs_of(methods: list[Method], num_runs: int) -> list[RunSpec]:
    """Runs without an end, the methods in turn, that learn after a short warm-up."""
    hyper = Hyper(warmup_steps=WARMUP_STEPS)
    specs = []
    for index in range(num_runs):
        seed, method = divmod(index, len(methods))
        specs.append(RunSpec(methods[method], seed, hyper_for(methods[method], hyper), 10**9))
    return specs


def warm_up(rollout: Rollout, chunks: Iterator[Any]) -> None:
    """Plays until every run learns, and compiles what the loop calls now and then."""
    next(chunks)
    while rollout.runs()[0].ticks < 2 * WARMUP_STEPS:
        next(chunks)
    for run in rollout.runs():
        rollout.diagnose(run)


def play(rollout: Rollout, chunks: Iterator[Any], seconds: float) -> Played:
    """Plays for some seconds; the learner has nothing to do before, and nothing left after."""

    def state() -> tuple[int, int, float]:
        rollout.wait()
        runs = rollout.runs()
        steps = sum(run.ticks - len(run.episodes) for run in runs)
        return runs[0].ticks, steps, sum(busy_seconds())

    ticks, steps, busy = state()
    stolen, start = stolen_seconds(), time.perf_counter()
    while time.perf_counter() - start < seconds:
        next(chunks)
    ticks_after, steps_after, busy_after = state()
    took, stolen = time.perf_counter() - start, stolen_seconds() - stolen
    return Played(ticks_after - ticks, steps_after - steps, took, busy_after - busy, stolen)


def measure_loop(seconds: float) -> list[Row]:
    """Rates, compiled programs and memory over time: the default learner with a small replay.

    Beside it what its updates and its ticks take alone, each with all cores and as full a replay.
    Acting, bookkeeping and waiting are what the loop adds.
    """
    config = LoopConfig(capacity=2 * WARMUP_STEPS)  # Full when the warm-up ends.
    agent = make_agent(AgentConfig())
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if event.endswith(COMPILED) else None
    )
    slots = num_slots(RUNS, RUNS)
    num_updates = config.num_updates(agent.learner.policy_delay)
    learn = make_learner(agent.config, slots, num_updates, loop=config)
    rows: list[Row] = []
    with make_pool("lean", slots) as inner, make_pool("lean", slots) as again:
        pool = _Recorded(inner)
        rollout = Rollout(agent, specs_of(list(Method), RUNS), pool, config)
        chunks = iter(rollout)
        warm_up(rollout, chunks)
        play(rollout, chunks, seconds)
        _replay(again, pool.ticks)
        for part in range(REPEATS):
            programs = len(compiled)
            played = play(rollout, chunks, 2 * seconds)
            cores_seconds = played.seconds * num_cores()
            programs, memory = len(compiled) - programs, memory_mb()
            walking = _replay(again, pool.ticks)
            learning = best(learn, seconds) * played.ticks / config.chunk
            rows.append(
                {
                    "part": part + 1,
                    "runs": RUNS,
                    "steps/s": round(played.steps / played.seconds),
                    "updates/s": round(
                        played.ticks * RUNS * config.updates_per_step / played.seconds
                    ),
                    "loop s": round(played.seconds, 2),
                    "learner alone s": round(learning, 2),
                    "walkers alone s": round(walking, 2),
                    "alone / loop": round((learning + walking) / played.seconds, 3),
                    "stolen": round(played.stolen / cores_seconds, 3),
                    "busy": round(played.busy / (cores_seconds - played.stolen), 3),
                    "bar": BAR,
                    "programs compiled": programs,
                    "memory MB": round(memory),
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
