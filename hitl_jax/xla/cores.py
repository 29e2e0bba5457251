"""The cores that this process may use; needs no JAX."""

import os


def num_cores() -> int:
    """Cores that this process may use: fewer than the machine has, under `taskset` for example."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
