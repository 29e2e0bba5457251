"""The JAX devices of learner, walkers and acting, and how many runs a device learns at once.

Each CPU device here is an XLA client of its own, with one thread; see `cpu_device`.
"""

import functools
import os
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import jax

from hitl_jax.xla.cores import num_cores

_ACTING = "acting"
_LEARNER_NICE = 10


@functools.cache
def learning_devices() -> tuple[jax.Device, ...]:
    """The devices that learn: JAX's accelerators if it has any, else one CPU device per core.

    Small matrix products do not split over cores; whole runs do. JAX_NUM_CPU_DEVICES, if set,
    replaces the number of cores.
    """
    if jax.default_backend() != "cpu":
        return tuple(jax.local_devices())
    asked: int = jax.config.jax_num_cpu_devices
    cores = asked if asked > 0 else num_cores()
    return tuple(cpu_device(f"learner {core}", _LEARNER_NICE) for core in range(cores))


def walker_devices(count: int) -> tuple[jax.Device, ...]:
    """The devices on which `--backend jax` steps walkers.

    Args:
        count: number of CPU devices.

    Returns:
        JAX's accelerators if it has any, else `count` CPU devices.
    """
    if jax.default_backend() != "cpu":
        return tuple(jax.local_devices())
    return tuple(cpu_device(f"walkers {number}") for number in range(count))


def default_tile(slots: int) -> int:
    """The default number of runs that one device learns at once.

    One on a CPU: XLA's sums are faster without an axis of runs, and one run's parameters, targets
    and moments (about a megabyte) fit into the core's cache. All its runs on an accelerator.

    Args:
        slots: number of runs of all devices together.
    """
    return 1 if jax.default_backend() == "cpu" else slots // len(learning_devices())


def acting_device() -> jax.Device:
    """The CPU device that acts; on a learner's device acting would wait for the learner.

    Its programs run on the thread that calls them, which has nothing else to do: handing a program
    to another thread and being woken takes as long as acting.
    """
    return cpu_device(_ACTING, own_thread=False)


@functools.cache
def cpu_device(name: str, nice: int = 0, own_thread: bool = True) -> jax.Device:
    """A CPU device whose programs run on one thread: its own, or the one that calls them.

    The devices of one XLA client share its threads, which move pieces of a program from core to
    core and from cache to cache: 30 runs then learn 1.3 to 1.4 times as slowly. So each device here
    is the only one of its client, which has one thread.

    The function that makes a client is not public in JAX. If this JAX does not have it, JAX's own
    CPU device is returned for every name, with a warning: it is slower, and rounds differently.

    On Linux threads have priorities: the learner's are lower, since every tick waits for acting and
    walkers, while the learner is a chunk or two behind anyway.

    Args:
        name: any; the same name gives the same device.
        nice: added to the niceness of the device's thread, on Linux.
        own_thread: whether programs run on the device's own thread.
    """
    nice = nice if sys.platform == "linux" else 0
    # A client's threads inherit from the one that starts it.
    with ThreadPoolExecutor(1) as starter:
        return starter.submit(_start, nice, own_thread).result()


def _start(nice: int, own_thread: bool) -> jax.Device:
    if nice:
        os.nice(nice)  # On Linux of this thread alone; it is added to the process's niceness.
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = "1"  # From this XLA's CPU client reads how many threads to start.
    try:
        from jaxlib.xla_client import make_cpu_client

        client = make_cpu_client(asynchronous=own_thread, num_devices=1)
    except (ImportError, TypeError):
        warnings.warn(
            f"JAX {jax.__version__} gives no device threads of its own: learning takes longer",
            stacklevel=1,
        )
        return jax.local_devices(backend="cpu")[0]
    finally:
        del os.environ["NPROC"]
        if before is not None:
            os.environ["NPROC"] = before
    return client.local_devices()[0]  # type: ignore[attr-defined]
