"""How the parts of the benchmark measure."""

import contextlib
import os
import pathlib
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import jax

Row = dict[str, Any]

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
    processes = ["self"]
    if children:
        tasks = proc.joinpath("self/task").glob("*/children")
        processes += " ".join(task.read_text() for task in tasks).split()
    for process in processes:
        with contextlib.suppress(OSError):  # It may have ended meanwhile.
            pages += int(proc.joinpath(process, "statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
