"""The number of cores that this process may use; needs no JAX."""

import os


def num_cores() -> int:
    """Number of cores that this process may use; under `taskset` fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
