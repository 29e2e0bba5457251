"""How the parts of the benchmark measure."""

import contextlib
import os
import pathlib
import resource
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax

REPEATS = 5


def best(call: Callable[[], Any], seconds: float) -> float:
    """Seconds a call in the best of several stretches; calls are queued as in real use."""
    jax.block_until_ready(call())
    start = time.perf_counter()
    jax.block_until_ready(call())
    count = max(1, int(seconds / REPEATS / (time.perf_counter() - start)))
    least = float("inf")
    for _ in range(REPEATS):
        start = time.perf_counter()
        for _ in range(count):
            result = call()
        jax.block_until_ready(result)
        least = min(least, (time.perf_counter() - start) / count)
    return least


def memory_mb(children: bool = False) -> float:
    """Resident memory of this process now [MB]; its peak where /proc is missing.

    Args:
        children: whether to add the processes that it started, with /proc; pages that several of
            them share count in each.
    """
    proc = pathlib.Path("/proc")
    if not proc.joinpath("self/statm").exists():
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1e6 if sys.platform == "darwin" else 1e3)
    pages = 0
    for process in ["self", *(_children() if children else [])]:
        with contextlib.suppress(OSError):  # It may have ended meanwhile.
            pages += int(proc.joinpath(process, "statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def device_mb() -> float:
    """The most memory that each of JAX's devices has held, added up [MB]; NaN if one is silent."""
    stats = [device.memory_stats() or {} for device in jax.local_devices()]
    return sum(float(told.get("peak_bytes_in_use", float("nan"))) for told in stats) / 1e6


class Busy(NamedTuple):
    """Core time since their start, of those that do the work [s]; NaN where /proc is missing.

    Attributes:
        learner: of this process's threads of lower priority, those that learn.
        walkers: of the processes that it started.
    """

    learner: float
    walkers: float


def busy_seconds() -> Busy:
    """Core time so far; differences are what counts, between which no process may end."""
    proc = pathlib.Path("/proc")
    if not proc.joinpath("self/stat").exists():
        return Busy(float("nan"), float("nan"))
    threads = _texts(proc.glob("self/task/*/stat"))
    children = _texts(proc / child / "stat" for child in _children())
    usual = _thread(proc.joinpath("self/stat").read_text(encoding="utf-8")).nice
    return Busy(
        learner=sum(one.seconds for one in map(_thread, threads) if one.nice > usual),
        walkers=sum(_thread(stat).seconds for stat in children),
    )


def stolen_seconds() -> float:
    """Core time that the host of a virtual machine kept from its cores so far; 0 where unknown.

    Of all the machine's cores, whichever this process may use.
    """
    stat = pathlib.Path("/proc/stat")
    if not stat.exists():
        return 0.0
    fields = stat.read_text(encoding="utf-8").split("\n", 1)[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


class _Thread(NamedTuple):
    seconds: float
    nice: int


def _thread(stat: str) -> _Thread:
    """What Linux counts of a thread, or of all threads of a process; see proc(5)."""
    fields = stat.rsplit(")", 1)[1].split()
    ticks = int(fields[11]) + int(fields[12])
    return _Thread(ticks / os.sysconf("SC_CLK_TCK"), int(fields[16]))


def _children() -> list[str]:
    return " ".join(_texts(pathlib.Path("/proc/self/task").glob("*/children"))).split()


def _texts(files: Iterable[pathlib.Path]) -> list[str]:
    """What files of /proc hold, but for those of threads and processes that have ended."""
    texts = []
    for file in files:
        with contextlib.suppress(OSError):
            texts.append(file.read_text(encoding="utf-8"))
    return texts
