"""Pools of walkers beside plain loops of official ones.

All step the same number of walkers with random actions. The pool's neighbours on the machine are
felt most here, so the rows take turns and each figure is the median over turns; the row of two
plain processes tells what two cores gave meanwhile.
"""

import multiprocessing
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from threading import Barrier

import numpy as np

from hitl_jax.benchmarks.timing import REPEATS
from hitl_jax.envs import WALKER, Command, make_pool
from hitl_jax.results.episode_measures import Row

WALKERS = 64
WORKERS = 2
START_SECONDS = 60.0
_WARM_UP = 60
"""Ticks before measuring: first steps of an episode cost more, and all walkers' come together."""
REFERENCE = "official, one plain process"


def measure_pool(seconds: float) -> list[Row]:
    """Steps/s of each way to step `WALKERS` walkers, and as a multiple of one plain process."""
    ways: dict[str, tuple[Callable[[], float], float | None]] = {
        "official, one plain process of one walker": (lambda: plain_rate(1, 1, seconds), None),
        REFERENCE: (lambda: plain_rate(1, WALKERS, seconds), None),
        "official, two plain processes": (lambda: plain_rate(2, WALKERS // 2, seconds), None),
        "--backend gymnasium (official), two workers": (
            lambda: pool_rate("gymnasium", WORKERS, seconds),
            1.7,
        ),
        "--backend lean, two workers": (lambda: pool_rate("lean", WORKERS, seconds), 4.0),
        "--backend envpool, two threads": (lambda: pool_rate("envpool", WORKERS, seconds), 4.0),
    }
    rates: dict[str, list[float]] = {name: [] for name in ways}
    missing: dict[str, str] = {}
    for _ in range(REPEATS):
        for name, (measure, _) in ways.items():
            try:
                rates[name].append(measure())
            except ImportError as error:
                missing[name] = str(error)
    rows: list[Row] = []
    for name, (_, bar) in ways.items():
        row: Row = {"pool": name}
        if name in missing:
            row["pool"] = f"{name}: {missing[name]}"
        else:
            ratios = [a / b for a, b in zip(rates[name], rates[REFERENCE], strict=True)]
            row["steps/s"] = round(statistics.median(rates[name]))
            row["ratio"] = round(statistics.median(ratios), 2)
            row["least"], row["most"] = round(min(ratios), 2), round(max(ratios), 2)
        if bar is not None:
            row["bar"] = bar
        rows.append(row)
    return rows


def plain_rate(processes: int, walkers: int, seconds: float) -> float:
    """Steps/s of plain loops in processes of their own, side by side."""
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(processes, context) as executor:
        ready = manager.Barrier(processes, timeout=START_SECONDS)
        jobs = [executor.submit(_plain_steps, ready, walkers, seconds) for _ in range(processes)]
        return sum(job.result() for job in jobs)


def _plain_steps(ready: Barrier, walkers: int, seconds: float) -> float:
    import gymnasium

    envs = [gymnasium.make(WALKER, disable_env_checker=True) for _ in range(walkers)]
    rng = np.random.default_rng(0)
    for seed, env in enumerate(envs):
        env.reset(seed=seed)
    ready.wait()
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        for env, action in zip(envs, _actions(rng, walkers), strict=True):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        steps += walkers
    return steps / (time.perf_counter() - start)


def pool_rate(backend: str, workers: int, seconds: float) -> float:
    """Steps/s of one of our pools."""
    (rate,) = pool_rates(backend, workers, seconds, WALKERS, 1)
    return rate


def pool_rates(
    backend: str, workers: int, seconds: float, walkers: int, stretches: int
) -> list[float]:
    """Steps/s of one of our pools, in stretches of some seconds one after the other."""
    rng = np.random.default_rng(0)
    seeds = np.arange(walkers, dtype=np.uint32)
    with make_pool(backend, walkers, workers) as pool:
        command = np.full(walkers, Command.RESET, np.uint8)

        def play() -> int:
            nonlocal command
            answer = pool.step(command, _actions(rng, walkers), seeds)
            steps = int((command == Command.STEP).sum())
            ended = answer.terminated | answer.truncated
            command = np.where(ended, Command.RESET, Command.STEP).astype(np.uint8)
            return steps

        for _ in range(_WARM_UP):
            play()
        rates = []
        for _ in range(stretches):
            steps, start = 0, time.perf_counter()
            while time.perf_counter() - start < seconds:
                steps += play()
            rates.append(steps / (time.perf_counter() - start))
    return rates


def _actions(rng: np.random.Generator, walkers: int) -> np.ndarray:
    return rng.uniform(-1, 1, (walkers, 4)).astype(np.float32)
