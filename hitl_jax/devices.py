"""The devices that learn, and the one that acts."""

import functools
import os

import jax
from jaxlib import xla_client

from hitl_jax.envs import num_cores

_ACTING = -1


@functools.cache
def learning_devices() -> tuple[jax.Device, ...]:
    """JAX's accelerators where it has any, else one CPU device a core.

    Small matrix products do not split over cores; whole runs do. JAX_NUM_CPU_DEVICES goes before
    the number of cores.
    """
    if jax.default_backend() != "cpu":
        return tuple(jax.local_devices())
    asked = jax.config.jax_num_cpu_devices
    return tuple(cpu_device(core) for core in range(asked if asked > 0 else num_cores()))


def acting_device() -> jax.Device:
    """A CPU device to itself, or acting would queue behind the learner."""
    return cpu_device(_ACTING)


@functools.cache
def cpu_device(number: int) -> jax.Device:
    """A CPU device whose programs run on a thread of its own.

    The devices of one XLA client share its threads, which pass pieces of a program from core to
    core and from cache to cache: the learner of 30 runs takes 1.4 to 1.6 times as long. So each
    device here is the only one of a client, with one thread.

    Args:
        number: any; the same number gives the same device.
    """
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = "1"  # where XLA's CPU client looks up how many threads to start
    try:
        client = xla_client.make_cpu_client(num_devices=1)
    finally:
        del os.environ["NPROC"]
        if before is not None:
            os.environ["NPROC"] = before
    return client.local_devices()[0]  # type: ignore[attr-defined]
