"""How JAX uses this machine; called before the first array is made."""

import os

import jax

from hitl_jax.envs import num_cores


def use_all_cores() -> None:
    """Makes one CPU device a core, so that runs are learned side by side, and one more for acting.

    Small matrix products do not split over threads; whole runs do. Never fewer than two devices
    learn: XLA compiles a mesh of one otherwise, and a run's numbers would depend on the machine's
    cores. JAX_NUM_CPU_DEVICES goes before.
    """
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", max(2, num_cores()) + 1)
