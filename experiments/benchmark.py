"""How near each part is to what this machine can do: `python -m experiments.benchmark`.

Every ratio is of two figures of one run, since machines differ and are noisy.
"""

import dataclasses
import itertools
import json
import os
import pathlib
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from experiments.cli import BadInput, run_main
from experiments.devices import use_all_cores
from hitl_jax import batch
from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import Command, make_pool, num_cores
from hitl_jax.provenance import versions
from hitl_jax.rollout import CPU_TILE, LoopConfig, Rollout, RunSpec

Row = dict[str, Any]
COMPILED = "backend_compile_duration"
"""End of the name of the event that JAX reports for each program that XLA compiles."""

PRODUCT_SIZE = 2048
REPEATS = 5


@dataclasses.dataclass(frozen=True)
class BenchmarkOptions:
    """Measure the learner, the pools of walkers and the whole loop on this machine.

    Attributes:
        only: parts to measure: some of learner, pool, loop.
        json: a file for the same numbers.
        tile: runs vmapped together on one device.
        seconds: time for one measurement [s].
    """

    only: tuple[str, ...] = ("learner", "pool", "loop")
    json: str | None = None
    tile: int = CPU_TILE
    seconds: float = 2.0


def main(options: BenchmarkOptions) -> int:
    """Measures, prints a table a part, and writes JSON if asked."""
    unknown = [part for part in options.only if part not in PARTS]
    if unknown or not options.only:
        raise BadInput(f"--only {' '.join(options.only)}: must be some of {', '.join(PARTS)}")
    if options.tile < 1:
        raise BadInput(f"--tile {options.tile}: must be at least 1")
    if not options.seconds > 0:
        raise BadInput(f"--seconds {options.seconds}: must be above 0")
    if options.json is not None and not pathlib.Path(options.json).resolve().parent.is_dir():
        raise BadInput(f"--json {options.json}: its folder does not exist")
    use_all_cores()
    console = Console(width=None if sys.stdout.isatty() else 120)
    report: dict[str, Any] = {"versions": versions(), "cores": num_cores()}
    for part in options.only:
        rows = PARTS[part](options)
        report[part] = rows
        _print(console, part, rows)
    if options.json is not None:
        pathlib.Path(options.json).write_text(json.dumps(report, indent=2) + "\n")
    return 0


def update_flops(config: AgentConfig) -> float:
    """Matrix-product FLOPs that one update of one run cannot do without, from the shapes.

    Counted: target actor and target critics forward; critics forward and backward without the
    gradient of their input; at every `policy_delay`-th update the actor forward and backward
    without the gradient of its input, and one critic forward and back to the action alone.
    """

    def layers(inputs: int, outputs: int) -> list[int]:
        sizes = [inputs, *config.hidden_sizes, outputs]
        return [a * b for a, b in itertools.pairwise(sizes)]

    observations, actions = config.observation_size, config.action_size
    actor = layers(observations, actions)
    critic = layers(observations + actions, 1)
    target = sum(actor) + config.num_critics * sum(critic)
    critics = config.num_critics * (3 * sum(critic) - critic[0])
    to_action = sum(critic[1:]) + actions * config.hidden_sizes[0]
    policy = (3 * sum(actor) - actor[0]) + sum(critic) + to_action
    return 2.0 * config.batch_size * (target + critics + policy / config.policy_delay)


def measure_product(seconds: float) -> float:
    """float32 matrix product over all cores [FLOP/s]."""
    n = PRODUCT_SIZE
    x = jnp.ones((n, n))
    product = jax.jit(lambda a: a @ a)
    return 2.0 * n**3 / _best(lambda: product(x), seconds)


def measure_learner(options: BenchmarkOptions) -> list[Row]:
    """Updates/s and GFLOP/s beside the product's rate, and the bars of the two sizes."""
    peak = measure_product(options.seconds)
    rows = [
        _learner_row(AgentConfig(hidden_sizes=(256, 256), batch_size=256), 12, 0.45, options),
        _learner_row(AgentConfig(hidden_sizes=(128, 128), batch_size=128), 30, 0.35, options),
    ]
    # The machine may have been faster or slower meanwhile: the higher figure is the bound.
    peak = max(peak, measure_product(options.seconds))
    for row in rows:
        row["product GFLOP/s"] = round(peak / 1e9, 1)
        row["ratio"] = round(row["GFLOP/s"] * 1e9 / peak, 3)
    return rows


def _learner_row(config: AgentConfig, runs: int, bar: float, options: BenchmarkOptions) -> Row:
    agent = make_agent(config)
    mesh = batch.make_mesh()
    runs = runs // mesh.size * mesh.size
    chunk, updates, capacity = 16, 8, 16 * 256
    hyper = jax.tree.map(np.asarray, hyper_for(Method.HITL_AC, Hyper()))
    seats = batch.empty_seats(agent, runs, capacity, mesh, hyper)
    programs = batch.make_programs(agent, mesh, updates, options.tile)
    for slot in range(runs):
        seats = programs.seat(seats, slot, hyper, jax.random.key(slot))
    layout = agent.layout
    frames = np.random.default_rng(0).normal(size=(runs, chunk, layout.width)).astype(np.float32)
    frames[:, :, layout.terminated : layout.final + 1] = 0.0
    share = runs // mesh.size
    slots = np.tile(np.arange(share, dtype=np.int32), mesh.size)
    nobody, everybody = (np.full(mesh.size, n, np.int32) for n in (0, share))
    for _ in range(capacity // chunk):
        seats = programs.learn(seats, frames, slots, nobody)

    def learn() -> Any:
        nonlocal seats
        seats = programs.learn(seats, frames, slots, everybody)
        return seats.train.learner.actor

    took = _best(learn, options.seconds)
    rate = runs * updates / took
    achieved = rate * update_flops(config)
    return {
        "network": "x".join(map(str, config.hidden_sizes)),
        "batch": config.batch_size,
        "runs": runs,
        "updates/s": round(rate),
        "GFLOP/s": round(achieved / 1e9, 1),
        "product GFLOP/s": 0.0,
        "ratio": 0.0,
        "bar": bar,
    }


def measure_pool(options: BenchmarkOptions) -> list[Row]:
    """Steps/s of one plain gymnasium process, of two workers, and of EnvPool with two threads."""
    walkers = 64
    plain = _plain_steps(options.seconds)
    rows = [{"pool": "gymnasium, one plain process", "walkers": 1, "steps/s": round(plain)}]
    for backend, bar in (("gymnasium", 1.7), ("envpool", 4.0)):
        try:
            rate = _pool_steps(backend, walkers, options.seconds)
        except ImportError as error:
            rows.append({"pool": f"{backend}: {error}", "walkers": walkers, "steps/s": 0})
            continue
        rows.append(
            {
                "pool": f"{backend}, two workers",
                "walkers": walkers,
                "steps/s": round(rate),
                "ratio": round(rate / plain, 2),
                "bar": bar,
            }
        )
    return rows


def _plain_steps(seconds: float) -> float:
    env = gymnasium.make("BipedalWalker-v3", disable_env_checker=True)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < 2 * seconds:
        _, _, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 4).astype(np.float32))
        steps += 1
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - start)


def _pool_steps(backend: str, walkers: int, seconds: float) -> float:
    rng = np.random.default_rng(0)
    seeds = np.arange(walkers, dtype=np.uint32)
    with make_pool(backend, walkers, 2) as pool:
        command = np.full(walkers, Command.RESET, np.uint8)
        action = np.zeros((walkers, 4), np.float32)
        pool.step(command, action, seeds)
        command[:] = Command.STEP
        steps, start = 0, time.perf_counter()
        while time.perf_counter() - start < 2 * seconds:
            action = rng.uniform(-1, 1, (walkers, 4)).astype(np.float32)
            answer = pool.step(command, action, seeds)
            steps += int((command == Command.STEP).sum())
            ended = answer.terminated | answer.truncated
            command = np.where(ended, Command.RESET, Command.STEP).astype(np.uint8)
        return steps / (time.perf_counter() - start)


def measure_loop(options: BenchmarkOptions) -> list[Row]:
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
    slots = len(specs) // batch.make_mesh().size * batch.make_mesh().size
    with make_pool("gymnasium", slots, None) as pool:
        rollout = Rollout(agent, specs, pool, config)
        chunks = iter(rollout)
        for _ in range(2 * (hyper.warmup_steps // config.chunk + 2)):
            next(chunks)
        for part in range(REPEATS):
            start, ticks = time.perf_counter(), 0
            while time.perf_counter() - start < 2 * options.seconds:
                next(chunks)
                ticks += config.chunk
            rate = ticks * slots / (time.perf_counter() - start)
            rows.append(
                {
                    "part": part + 1,
                    "runs": slots,
                    "steps/s": round(rate),
                    "updates/s": round(rate * config.updates_per_step),
                    "programs compiled": len(compiled),
                    "memory MB": round(_memory_mb()),
                }
            )
    return rows


PARTS: dict[str, Callable[[BenchmarkOptions], list[Row]]] = {
    "learner": measure_learner,
    "pool": measure_pool,
    "loop": measure_loop,
}


def _best(call: Callable[[], Any], seconds: float) -> float:
    """Seconds a call in the best of several stretches; calls are queued as in real use."""
    jax.block_until_ready(call())
    start = time.perf_counter()
    jax.block_until_ready(call())
    count = max(1, int(seconds / REPEATS / (time.perf_counter() - start)))
    best = float("inf")
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(count):
            result = call()
        jax.block_until_ready(result)
        best = min(best, (time.perf_counter() - start) / count)
    return best


def _memory_mb() -> float:
    """Resident memory of this process now [MB]; its peak where /proc is missing."""
    try:
        pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def _print(console: Console, title: str, rows: list[Row]) -> None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = Table(title=title, title_justify="left")
    for name in names:
        table.add_column(name, justify="left" if name in ("pool", "network") else "right")
    for row in rows:
        table.add_row(*(str(row.get(name, "")) for name in names))
    console.print(table)


if __name__ == "__main__":
    sys.exit(run_main(BenchmarkOptions, main))
