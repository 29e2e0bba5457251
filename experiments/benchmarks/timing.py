"""How the parts of the benchmark measure."""

import os
import pathlib
import resource
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


def memory_mb() -> float:
    """Resident memory of this process and its children now [MB]; our own peak without /proc."""
    try:
        tasks = pathlib.Path("/proc/self/task").glob("*/children")
        processes = ["self", *" ".join(task.read_text() for task in tasks).split()]
        files = [pathlib.Path(f"/proc/{process}/statm") for process in processes]
        pages = sum(int(file.read_text().split()[1]) for file in files)
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
