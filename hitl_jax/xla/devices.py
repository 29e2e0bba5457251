"""The devices that learn, how many runs each learns together, and the one that acts."""

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
    """JAX's accelerators where it has any, else one CPU device a core.

    Small matrix products do not split over cores; whole runs do. JAX_NUM_CPU_DEVICES goes before
    the number of cores.
    """
    if jax.default_backend() != "cpu":
        return tuple(jax.local_devices())
    asked: int = jax.config.jax_num_cpu_devices
    cores = asked if asked > 0 else num_cores()
    return tuple(cpu_device(f"learner {core}", _LEARNER_NICE) for core in range(cores))


def walker_devices(count: int) -> tuple[jax.Device, ...]:
    """The devices on which `--backend jax` steps walkers.

    Args:
        count: how many are wanted, if they are CPU devices.

    Returns:
        JAX's accelerators where it has any, else as many CPU devices.
    """
    if jax.default_backend() != "cpu":
        return tuple(jax.local_devices())
    return tuple(cpu_device(f"walkers {number}") for number in range(count))


def default_tile(slots: int) -> int:
    """Runs learned together on one device.

    On a CPU one: XLA's sums are faster without an axis of runs, and the megabyte of one run's
    parameters, targets and moments stays nearer to the core than that of several. On an accelerator
    all that it has.

    Args:
        slots: of all devices together.
    """
    return 1 if jax.default_backend() == "cpu" else slots // len(learning_devices())


def acting_device() -> jax.Device:
    """A CPU device to itself, or acting would queue behind the learner.

    Its programs run on the thread that calls them, which has nothing else to do: to hand one over
    to another thread and to be woken takes as long as to act.
    """
    return cpu_device(_ACTING, own_thread=False)


@functools.cache
def cpu_device(name: str, nice: int = 0, own_thread: bool = True) -> jax.Device:
    """A CPU device whose programs run on a thread of its own, or on the one that calls them.

    The devices of one XLA client share its threads, which pass pieces of a program from core to
    core and from cache to cache: the learner of 30 runs takes 1.3 to 1.4 times as long. So each
    device here is the only one of a client, with one thread.

    The name that makes a client is not public in JAX. A JAX without it gives its own CPU device,
    whatever the name, and a warning: slower, and rounded otherwise.

    Where threads can have priorities (Linux), those of the learner let others go first: acting and
    walkers are waited for at every tick, the learner has a chunk or two in hand.

    Args:
        name: any; the same name gives the same device.
        nice: by how much its threads go last, on Linux.
        own_thread: whether programs run on its own.
    """
    nice = nice if sys.platform == "linux" else 0
    # A client's threads inherit from the one that starts it.
    with ThreadPoolExecutor(1) as starter:
        return starter.submit(_start, nice, own_thread).result()


def _start(nice: int, own_thread: bool) -> jax.Device:
    if nice:
        os.nice(nice)  # Of this thread alone, on Linux, and added to what the process has.
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = "1"  # where XLA's CPU client looks up how many threads to start
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
