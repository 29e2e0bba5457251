"""A Ray cluster: how to come to it, and how runs are divided among its machines."""

import contextlib
import itertools
import logging
import math
import os
import pathlib
import socket
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from hitl_jax.errors import InvalidValue, LaunchError, first_line
from hitl_jax.sweep.train_and_test import Batch
from hitl_jax.xla.cores import num_cores

_CONNECT_SECONDS = 10.0
_UNUSED_SHARE = 0.25


class Places(NamedTuple):
    """What a cluster has room for.

    Attributes:
        groups: at a time.
        cpus: cores that each takes.
        gpus: GPUs that each takes: one, where a machine has any.
        unused: machines that have no room for a group.
    """

    groups: int
    cpus: int
    gpus: int
    unused: int


_FOR_THIS_MACHINE = {
    # Who may speak to a cluster may run programs on it: with its token alone.
    "RAY_AUTH_MODE": "token",
    # Despite its name it holds on Linux too: Ray then listens on the loopback only.
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
}
"""Of a cluster of this machine alone; Ray reads them as it is imported."""


@contextlib.contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Connects to a cluster, and leaves it at the end: what it does for us ends then.

    Args:
        address: as `ray.init` takes it; None begins a cluster of this machine alone.

    Raises:
        InvalidValue: one line, if there is no cluster, or with the extra to install.
    """
    # Nobody has asked for it; it would tell Ray's makers of each start.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address is None:
        for name, value in _FOR_THIS_MACHINE.items():
            os.environ.setdefault(name, value)
    try:
        import ray
    except ImportError as error:
        raise InvalidValue("launcher", "ray", 'needs pip install -e ".[ray]"') from error
    if address is None:
        options: dict[str, Any] = {
            "address": "local",
            "num_cpus": num_cores(),
            "include_dashboard": False,
        }
    else:
        _require_there(address)
        # Machines need what we depend on, and get our own code from here.
        code = str(pathlib.Path(__file__).parents[2])
        options = {"address": address, "runtime_env": {"py_modules": [code]}}
    try:
        ray.init(logging_level=logging.ERROR, **options)
    except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
        asked = ("launcher", "ray") if address is None else ("ray_address", address)
        raise InvalidValue(*asked, f"no cluster: {first_line(error)}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _require_there(address: str) -> None:
    """Refuses an address where nobody listens: Ray would try for minutes, and end the process."""
    host, _, port = address.rpartition(":")
    if port.isdecimal() and "/" not in host:
        try:
            socket.create_connection((host, int(port)), timeout=_CONNECT_SECONDS).close()
        except (OSError, OverflowError) as error:
            raise InvalidValue("ray_address", address, f"no cluster: {error}") from error


def places_of(nodes: Sequence[dict[str, Any]]) -> Places:
    """How many groups of runs the machines of a cluster can make at a time.

    Where there are GPUs, a group takes one, and a machine's cores are shared by its GPUs. Elsewhere
    groups are as large as leaves no more than a quarter of all cores unused: a small machine
    among large ones is not worth small groups.

    Args:
        nodes: of `ray.nodes()`.

    Raises:
        LaunchError: if no machine has a core.
    """
    has = [node["Resources"] for node in nodes if node["Alive"]]
    rooms = [(int(one.get("CPU", 0)), int(one.get("GPU", 0))) for one in has]
    rooms = [(cpus, gpus) for cpus, gpus in rooms if cpus >= 1]
    if not rooms:
        raise LaunchError("the Ray cluster has no machine with a core for us")
    with_gpus = [(cpus, gpus) for cpus, gpus in rooms if cpus >= gpus >= 1]
    if with_gpus:
        cpus = min(cpus // gpus for cpus, gpus in with_gpus)
        groups = sum(gpus for _, gpus in with_gpus)
        return Places(groups, cpus, 1, len(rooms) - len(with_gpus))
    sizes = [cpus for cpus, _ in rooms]
    used = {size: sum(cpus // size for cpus in sizes) * size for size in sizes}
    size = max(size for size in sizes if used[size] >= (1 - _UNUSED_SHARE) * sum(sizes))
    return Places(used[size] // size, size, 0, sum(cpus < size for cpus in sizes))


def divided(batches: Sequence[Batch], places: int) -> list[Batch]:
    """Batches in groups of about one size: as few rounds as their slots allow, no place empty.

    Args:
        batches: each with `walkers.slots` runs at a time at most.
        places: groups at a time.
    """
    runs = sum(len(batch.specs) for batch in batches)
    groups = []
    for batch in batches:
        rounds = math.ceil(runs / (places * batch.walkers.slots))
        size = math.ceil(runs / (places * max(rounds, 1)))
        count = math.ceil(len(batch.specs) / max(size, 1))
        ends = [len(batch.specs) * number // max(count, 1) for number in range(count + 1)]
        groups += [
            batch._replace(specs=batch.specs[first:stop])
            for first, stop in itertools.pairwise(ends)
        ]
    return groups
