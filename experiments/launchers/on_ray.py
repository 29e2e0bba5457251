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
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, NamedTuple

from experiments.compile_cache import keep_programs
from experiments.signals import deferred_interrupts
from experiments.training import Batch, Tested, train_and_test
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


class LaunchError(RuntimeError):
    """What went wrong on another machine, in one line."""


class Places(NamedTuple):
    """What a cluster has room for.

    Attributes:
        groups: at a time.
        cpus: cores that each takes: all of the smallest machine.
        gpus: GPUs that each takes: one, where the cluster has any.
    """

    groups: int
    cpus: int
    gpus: int


class _Begun(NamedTuple):
    """A machine begins with a group.

    Attributes:
        group: its number.
        machine: the name.
        keys: the runs that have not come yet.
    """

    group: int
    machine: str
    keys: list[RunKey]


class _Seen(NamedTuple):
    """How runs under way have gone on: by run, its new episodes and all its steps."""

    runs: list[tuple[RunKey, list[Row], int]]


_Message = _Begun | _Seen | Tested


class OnRay:
    """Groups of runs, each on the cores of one machine; to be used while `connected`.

    Args:
        say: prints a line.
    """

    goes_on = "The same command makes the runs that are missing, each from its beginning."

    def __init__(self, say: Callable[[str], None]):
        self._say = say

    def make(
        self, batches: Sequence[Batch], show: Callable[[Sequence[Run]], None]
    ) -> Generator[Tested]:
        """See `Launcher.make`.

        Raises:
            LaunchError: if a group fails, or lost too many machines.
        """
        import ray
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        places = places_of(ray.nodes())
        groups = divided(batches, places.groups)
        if not groups:
            return
        num_runs = sum(len(group.specs) for group in groups)
        self._say(
            f"{num_runs} runs in {len(groups)} groups on a Ray cluster with room for "
            f"{places.groups}, each of {places.cpus} cores" + " and a GPU" * places.gpus
        )
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        inbox = ray.remote(_Inbox).options(num_cpus=0, scheduling_strategy=here).remote()
        remote = ray.remote(_make_group).options(
            num_cpus=places.cpus,
            num_gpus=places.gpus,
            max_retries=_RETRIES,
            runtime_env={"env_vars": {"JAX_NUM_CPU_DEVICES": str(places.cpus)}},
        )
        commit = git_commit() or "unknown"
        tasks = [
            remote.remote(number, _with_workers(group, places.cpus), commit, inbox)
            for number, group in enumerate(groups)
        ]
        yield from self._delivered(groups, inbox, tasks, show)

    def _delivered(
        self,
        groups: Sequence[Batch],
        inbox: Any,
        tasks: list[Any],
        show: Callable[[Sequence[Run]], None],
    ) -> Generator[Tested]:
        import ray

        specs = {spec.key: spec for group in groups for spec in group.specs}
        running: dict[RunKey, Run] = {}
        begun: set[int] = set()
        with deferred_interrupts() as interrupted:
            while specs:
                messages = _got(inbox.take.remote(_WAIT_SECONDS))
                for message in messages:
                    if isinstance(message, Tested):
                        running.pop(message.key, None)
                        del specs[message.key]
                        yield message
                    elif isinstance(message, _Begun):
                        lost = "a machine was lost: " if message.group in begun else ""
                        self._say(f"{lost}{message.machine} begins {len(message.keys)} runs")
                        begun.add(message.group)
                        running |= {key: Run(specs[key], 0) for key in message.keys}
                    else:
                        for key, rows, env_steps in message.runs:
                            if key in running:
                                running[key].episodes.extend(rows)
                                running[key].env_steps = env_steps
                show(list(running.values()))
                interrupted()
                ended, tasks = ray.wait(tasks, num_returns=len(tasks), timeout=0)
                for task in ended:
                    _got(task)
                if not tasks and not messages and specs:
                    raise LaunchError(f"{len(specs)} runs were never delivered")


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
        said = str(error).strip().splitlines()[0]
        raise ValueError(f"--ray-address {address}: no cluster: {said}") from error
    try:
        yield
    finally:
        ray.shutdown()


def places_of(nodes: Sequence[dict[str, Any]]) -> Places:
    """How many groups of runs the machines of a cluster can make at a time.

    Args:
        nodes: of `ray.nodes()`.

    Raises:
        LaunchError: if no machine has a core.
    """
    has = [node["Resources"] for node in nodes if node["Alive"]]
    gpus = int(any(resources.get("GPU", 0) >= 1 for resources in has))
    rooms = [
        (int(resources.get("CPU", 0)), int(resources.get("GPU", 0)) if gpus else 1)
        for resources in has
    ]
    rooms = [(cpus, groups) for cpus, groups in rooms if cpus >= groups >= 1]
    if not rooms:
        raise LaunchError("the Ray cluster has no machine with a core for us")
    cpus = min(cores // groups for cores, groups in rooms)
    return Places(sum(groups if gpus else cores // cpus for cores, groups in rooms), cpus, gpus)


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
        self._filled = asyncio.Event()

    async def missing(self, keys: Sequence[RunKey]) -> list[RunKey]:
        return [key for key in keys if key not in self._came]

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
    """What a machine does: makes the runs of a group that have not come, and delivers each."""
    keep_programs()
    keys = _got(inbox.missing.remote([spec.key for spec in batch.specs]))
    _got(inbox.put.remote(_Begun(number, platform.node(), keys)))
    batch = batch._replace(specs=[spec for spec in batch.specs if spec.key in set(keys)])
    if not batch.specs:
        return
    told: dict[RunKey, int] = {}
    told_at = -math.inf

    def watch(rollout: Rollout) -> None:
        nonlocal told_at
        if time.monotonic() - told_at >= _REPORT_SECONDS:
            told_at = time.monotonic()
            inbox.put.remote(_Seen([_news(run, told) for run in rollout.runs()]))

    with contextlib.closing(train_and_test(batch, watch)) as made:
        for tested in made:
            run = dataclasses.replace(tested.finished.run, snapshots=[])
            finished = dataclasses.replace(tested.finished, run=run)
            _got(inbox.put.remote(tested._replace(finished=finished, commit=commit)))


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
        said = str(cause).strip().splitlines() or [type(cause).__name__]
        raise LaunchError(f"on the Ray cluster: {said[0]}") from error
