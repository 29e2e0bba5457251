"""How JAX uses this machine; called before the first array is made."""

import os

import jax


def use_all_cores() -> None:
    """Makes one CPU device a core, so that runs are learned on all of them side by side.

    Small matrix products do not split over threads; whole runs do. JAX_NUM_CPU_DEVICES goes before.
    """
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))
