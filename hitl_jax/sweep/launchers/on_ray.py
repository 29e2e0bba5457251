"""Makes runs on the machines of a Ray cluster.

Ray decides which machine makes which group of runs, makes a group again if its machine dies, and
moves what they tell. A run is delivered as it ends, whole, to an inbox on the driver's machine,
which knows each run by its name: a group that begins again makes those that have not come.
"""

import math
import os
import pathlib
import time
from collections.abc import Callable, Collection, Generator, Sequence
from typing import Any

from hitl_jax.errors import LaunchError
from hitl_jax.results.provenance import git_commit
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.autosave import UnderWay
from hitl_jax.sweep.launchers.cluster import Places, divided, places_of
from hitl_jax.sweep.launchers.machine import Begun, Inbox, got, make_group
from hitl_jax.sweep.signals import Interrupted, deferred_interrupts
from hitl_jax.sweep.train_and_test import Batch, Tested
from hitl_jax.training.run_spec import Run

_RETRIES = 20
"""How many machines a group may lose."""

_WAIT_SECONDS = 1.0
_IDLE_SECONDS = 30.0


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
                "runs that the local launcher has saved begin anew here; it would go on with them"
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
                for message in got(inbox.take.remote(0.0 if stopped else _WAIT_SECONDS)):
                    if isinstance(message, Tested):
                        running.pop(message.key, None)
                        del specs[message.key]
                        yield message
                    elif isinstance(message, Begun):
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
                        got(task)
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
    inbox = ray.remote(Inbox).options(num_cpus=0, scheduling_strategy=here).remote()
    devices = os.environ.get("JAX_NUM_CPU_DEVICES", str(places.cpus))
    # A process for each group, so that none keeps programs and memory of the group before.
    remote = ray.remote(max_calls=1)(make_group).options(
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


def _with_workers(batch: Batch, cpus: int) -> Batch:
    return batch._replace(walkers=batch.walkers._replace(workers=batch.walkers.workers or cpus))
