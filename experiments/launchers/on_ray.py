"""Makes runs on the machines of a Ray cluster.

Ray decides which machine makes which group of runs, makes a group again if its machine dies, and
moves what they tell. A run is delivered as it ends, whole, to an inbox on the driver's machine,
which knows each run by its name: a group that begins again makes those that have not come.
"""

import asyncio
import contextlib
import dataclasses
import importlib
import itertools
import logging
import math
import os
import pathlib
import platform
import socket
import time
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from typing import Any, NamedTuple

from experiments.cli import LaunchError
from experiments.compile_cache import keep_programs
from experiments.signals import Interrupted, deferred_interrupts
from experiments.training import Batch, Tested, train_and_test
from experiments.under_way import UnderWay
from hitl_jax.envs import num_cores
from hitl_jax.episodes import Row
from hitl_jax.provenance import git_commit
from hitl_jax.rollout import Rollout
from hitl_jax.run_key import RunKey
from hitl_jax.runs import Run

_RETRIES = 20
"""How many machines a group may lose."""

_REPORT_SECONDS = 10.0
_WAIT_SECONDS = 1.0
_IDLE_SECONDS = 30.0
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


class _Begun(NamedTuple):
    """A machine begins with a group.

    Attributes:
        group: its number.
        attempt: how often the group has begun.
        machine: the name.
        keys: the runs that have not come yet.
    """

    group: int
    attempt: int
    machine: str
    keys: list[RunKey]


class _Seen(NamedTuple):
    """How the runs of a group have gone on.

    Attributes:
        group: its number.
        attempt: whose runs they are.
        runs: of each the new episodes, and all its steps.
    """

    group: int
    attempt: int
    runs: list[tuple[RunKey, list[Row], int]]


_Message = _Begun | _Seen | Tested


class OnRay:
    """Groups of runs, each on cores of one machine; to be used while `connected`.

    Args:
        folder: where `Local` would have saved what is under way.
        finished: the runs that are kept.
        say: prints a line.
    """

    def __init__(
        self,
        folder: pathlib.Path,
        finished: Callable[[], Collection[RunKey]],
        say: Callable[[str], None],
    ):
        self._folder, self._finished, self._say = folder, finished, say

    def make(
        self, batches: Sequence[Batch], show: Callable[[Sequence[Run]], None]
    ) -> Generator[Tested]:
        """See `Launcher.make`.

        Raises:
            LaunchError: when all else is done, if groups failed or lost too many machines.
        """
        import ray

        saves = [self._folder / batch.name for batch in batches if batch.specs]
        if any(path.exists() for path in saves):
            self._say(
                "runs that --launcher local has saved begin anew here; it would go on with them"
            )
        places = places_of(ray.nodes())
        if places.unused:
            self._say(f"{places.unused} machines of the cluster have no room for a group: not used")
        groups = divided(batches, places.groups)
        if groups:
            num_runs = sum(len(group.specs) for group in groups)
            self._say(
                f"{num_runs} runs in {len(groups)} groups on a Ray cluster with room for "
                f"{places.groups}, each of {places.cpus} cores" + " and a GPU" * places.gpus
            )
            inbox, tasks = _submitted(groups, places)
            yield from self._delivered(groups, inbox, tasks, show)
        for batch in batches:
            saved = UnderWay(self._folder / batch.name, batch.loop.frames)
            saved.tidy(self._finished(), self._say)

    def _delivered(
        self,
        groups: Sequence[Batch],
        inbox: Any,
        tasks: dict[Any, int],
        show: Callable[[Sequence[Run]], None],
    ) -> Generator[Tested]:
        specs = {spec.key: spec for group in groups for spec in group.specs}
        running: dict[RunKey, Run] = {}
        attempts: dict[int, int] = {}
        failures: list[str] = []
        stopped: Interrupted | None = None
        idle_since = time.monotonic()
        with deferred_interrupts() as interrupted:
            while True:
                for message in _got(inbox.take.remote(0.0 if stopped else _WAIT_SECONDS)):
                    if isinstance(message, Tested):
                        running.pop(message.key, None)
                        del specs[message.key]
                        yield message
                    elif isinstance(message, _Begun):
                        attempts[message.group] = message.attempt
                        lost = "a machine was lost: " if message.attempt > 1 else ""
                        self._say(f"{lost}{message.machine} begins {len(message.keys)} runs")
                        # One may have come after all, from a machine that was thought dead.
                        keys = specs.keys() & set(message.keys)
                        running |= {key: Run(specs[key], 0) for key in keys}
                    elif message.attempt == attempts[message.group]:
                        for key, rows, env_steps in message.runs:
                            if key in running:
                                running[key].episodes.extend(rows)
                                running[key].env_steps = env_steps
                if stopped:
                    raise stopped
                show(list(running.values()))
                if not tasks or not specs:  # A task ends when the inbox has all its runs.
                    break
                try:
                    interrupted()
                except Interrupted as stop:
                    stopped = stop  # What has come meanwhile is taken first.
                for task in _ended(tasks):
                    group = groups[tasks.pop(task)]
                    try:
                        _got(task)
                    except LaunchError as error:
                        failures.append(str(error))
                        self._say(f"a group of {len(group.specs)} runs failed: {error}")
                        for spec in group.specs:
                            running.pop(spec.key, None)
                if running or not tasks:
                    idle_since = time.monotonic()
                elif time.monotonic() - idle_since > _IDLE_SECONDS:
                    idle_since = math.inf
                    self._say("waiting for the cluster: no machine has room for a group yet")
        if specs:
            said = failures[0] if failures else "they were never delivered"
            raise LaunchError(f"{len(specs)} runs are missing: {said}")


def _submitted(groups: Sequence[Batch], places: Places) -> tuple[Any, dict[Any, int]]:
    """Hands groups to Ray; the inbox, and the number of each task's group."""
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    inbox = ray.remote(_Inbox).options(num_cpus=0, scheduling_strategy=here).remote()
    devices = os.environ.get("JAX_NUM_CPU_DEVICES", str(places.cpus))
    # A process for each group, so that none keeps programs and memory of the group before.
    remote = ray.remote(max_calls=1)(_make_group).options(
        num_cpus=places.cpus,
        num_gpus=places.gpus,
        max_retries=_RETRIES,
        runtime_env={"env_vars": {"JAX_NUM_CPU_DEVICES": devices}},
    )
    commit = git_commit() or "unknown"
    tasks = {
        remote.remote(number, _with_workers(group, places.cpus), commit, inbox): number
        for number, group in enumerate(groups)
    }
    return inbox, tasks


def _ended(tasks: Collection[Any]) -> list[Any]:
    import ray

    ended: list[Any] = ray.wait(list(tasks), num_returns=len(tasks), timeout=0)[0]
    return ended


@contextlib.contextmanager
def connected(address: str | None) -> Iterator[None]:
    """Connects to a cluster, and leaves it at the end: what it does for us ends then.

    Args:
        address: as `ray.init` takes it; None begins a cluster of this machine alone.

    Raises:
        ValueError: one line, if there is no cluster.
        ImportError: one line with the extra to install.
    """
    # Nobody has asked for it; it would tell Ray's makers of each start.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise ImportError('--launcher ray needs: pip install -e ".[ray]"') from error
    if address is None:
        options: dict[str, Any] = {
            "address": "local",
            "num_cpus": num_cores(),
            "include_dashboard": False,
        }
    else:
        _require_there(address)
        # Machines need what we depend on, and get our own code from here.
        packages = ("hitl_jax", "experiments")
        folders = [
            str(pathlib.Path(str(importlib.import_module(name).__file__)).parent)
            for name in packages
        ]
        options = {"address": address, "runtime_env": {"py_modules": folders}}
    try:
        ray.init(logging_level=logging.ERROR, **options)
    except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
        asked = "--launcher ray" if address is None else f"--ray-address {address}"
        raise ValueError(f"{asked}: no cluster: {_first_line(error)}") from error
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
            raise ValueError(f"--ray-address {address}: no cluster: {error}") from error


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
        batches: each with `plant.slots` runs at a time at most.
        places: groups at a time.
    """
    runs = sum(len(batch.specs) for batch in batches)
    groups = []
    for batch in batches:
        rounds = math.ceil(runs / (places * batch.plant.slots))
        size = math.ceil(runs / (places * max(rounds, 1)))
        count = math.ceil(len(batch.specs) / max(size, 1))
        ends = [len(batch.specs) * number // max(count, 1) for number in range(count + 1)]
        groups += [
            batch._replace(specs=batch.specs[first:stop])
            for first, stop in itertools.pairwise(ends)
        ]
    return groups


def _with_workers(batch: Batch, cpus: int) -> Batch:
    return batch._replace(plant=batch.plant._replace(workers=batch.plant.workers or cpus))


class _Inbox:
    """What machines tell the driver, in order, and which runs have come; an actor of Ray's."""

    def __init__(self) -> None:
        self._messages: list[_Message] = []
        self._came: set[RunKey] = set()
        self._attempts: dict[int, int] = {}
        self._filled = asyncio.Event()

    async def begin(self, group: int, machine: str, keys: Sequence[RunKey]) -> _Begun:
        """Notes that a machine begins with a group; which attempt it is, and what is missing."""
        self._attempts[group] = self._attempts.get(group, 0) + 1
        missing = [key for key in keys if key not in self._came]
        begun = _Begun(group, self._attempts[group], machine, missing)
        await self.put(begun)
        return begun

    async def put(self, message: _Message) -> None:
        """Keeps a message; of a run that is made twice, as by a machine thought dead, the first."""
        if isinstance(message, Tested):
            if message.key in self._came:
                return
            self._came.add(message.key)
        self._messages.append(message)
        self._filled.set()

    async def take(self, seconds: float) -> list[_Message]:
        """All that has come, once there is something, or this time has passed."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._filled.wait(), seconds)
        self._filled.clear()
        messages, self._messages = self._messages, []
        return messages


def _make_group(number: int, batch: Batch, commit: str, inbox: Any) -> None:
    """What a machine does: makes the runs of a group that have not come, and delivers each.

    Raises:
        LaunchError: naming the machine, if that fails.
    """
    machine = platform.node()
    keep_programs()
    begun = _got(inbox.begin.remote(number, machine, [spec.key for spec in batch.specs]))
    keys = set(begun.keys)
    batch = batch._replace(specs=[spec for spec in batch.specs if spec.key in keys])
    if not batch.specs:
        return
    told: dict[RunKey, int] = {}
    told_at = -math.inf

    def watch(rollout: Rollout) -> None:
        nonlocal told_at
        if time.monotonic() - told_at >= _REPORT_SECONDS:
            told_at = time.monotonic()
            news = [_news(run, told) for run in rollout.runs()]
            inbox.put.remote(_Seen(number, begun.attempt, news))

    try:
        with contextlib.closing(train_and_test(batch, watch)) as made:
            for tested in made:
                run = dataclasses.replace(tested.finished.run, snapshots=[])
                finished = dataclasses.replace(tested.finished, run=run)
                _got(inbox.put.remote(tested._replace(finished=finished, commit=commit)))
    except Interrupted:
        # A signal to this process: its machine is going. Ray takes a process that dies for that,
        # and an exception for an answer.
        os._exit(1)
    except Exception as error:
        notes = "; ".join(getattr(error, "__notes__", []))
        raise LaunchError(f"{machine}: {_first_line(error)} {notes}".strip()) from error


def _news(run: Run, told: dict[RunKey, int]) -> tuple[RunKey, list[Row], int]:
    """The episodes of a run that were not told before."""
    key = run.spec.key
    rows = run.episodes[told.get(key, 0) :]
    told[key] = len(run.episodes)
    return key, rows, run.env_steps


def _got(reference: Any) -> Any:
    """What a reference of Ray's stands for.

    Raises:
        LaunchError: one line, if it cannot be had.
    """
    import ray

    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        cause = getattr(error, "cause", None) or error
        raise LaunchError(_first_line(cause)) from error


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
