"""What the machines of a Ray cluster do, and what they tell the driver."""

import asyncio
import contextlib
import dataclasses
import math
import os
import platform
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

from hitl_jax.errors import LaunchError, first_line
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.signals import Interrupted
from hitl_jax.sweep.train_and_test import Batch, Tested, train_and_test
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import Run

_REPORT_SECONDS = 10.0


class Begun(NamedTuple):
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


class Seen(NamedTuple):
    """How the runs of a group have gone on.

    Attributes:
        group: its number.
        attempt: whose runs they are.
        runs: of each the new episodes, and all its steps.
    """

    group: int
    attempt: int
    runs: list[tuple[RunKey, list[Row], int]]


Message = Begun | Seen | Tested


class Inbox:
    """What machines tell the driver, in order, and which runs have come; an actor of Ray's."""

    def __init__(self) -> None:
        self._messages: list[Message] = []
        self._came: set[RunKey] = set()
        self._attempts: dict[int, int] = {}
        self._filled = asyncio.Event()

    async def begin(self, group: int, machine: str, keys: Sequence[RunKey]) -> Begun:
        """Notes that a machine begins with a group; which attempt it is, and what is missing."""
        self._attempts[group] = self._attempts.get(group, 0) + 1
        missing = [key for key in keys if key not in self._came]
        begun = Begun(group, self._attempts[group], machine, missing)
        await self.put(begun)
        return begun

    async def put(self, message: Message) -> None:
        """Keeps a message; of a run that is made twice, as by a machine thought dead, the first."""
        if isinstance(message, Tested):
            if message.key in self._came:
                return
            self._came.add(message.key)
        self._messages.append(message)
        self._filled.set()

    async def take(self, seconds: float) -> list[Message]:
        """All that has come, once there is something, or this time has passed."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._filled.wait(), seconds)
        self._filled.clear()
        messages, self._messages = self._messages, []
        return messages


def make_group(number: int, batch: Batch, commit: str, inbox: Any) -> None:
    """What a machine does: makes the runs of a group that have not come, and delivers each.

    Raises:
        LaunchError: naming the machine, if that fails.
    """
    machine = platform.node()
    keep_programs()
    begun = got(inbox.begin.remote(number, machine, [spec.key for spec in batch.specs]))
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
            inbox.put.remote(Seen(number, begun.attempt, news))

    try:
        with contextlib.closing(train_and_test(batch, watch)) as made:
            for tested in made:
                run = dataclasses.replace(tested.finished.run, snapshots=[])
                finished = dataclasses.replace(tested.finished, run=run)
                got(inbox.put.remote(tested._replace(finished=finished, commit=commit)))
    except Interrupted:
        # A signal to this process: its machine is going. Ray takes a process that dies for that,
        # and an exception for an answer.
        os._exit(1)
    except Exception as error:
        notes = "; ".join(getattr(error, "__notes__", []))
        raise LaunchError(f"{machine}: {first_line(error)} {notes}".strip()) from error


def _news(run: Run, told: dict[RunKey, int]) -> tuple[RunKey, list[Row], int]:
    """The episodes of a run that were not told before."""
    key = run.spec.key
    rows = run.episodes[told.get(key, 0) :]
    told[key] = len(run.episodes)
    return key, rows, run.env_steps


def got(reference: Any) -> Any:
    """What a reference of Ray's stands for.

    Raises:
        LaunchError: one line, if it cannot be had.
    """
    import ray

    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        cause = getattr(error, "cause", None) or error
        raise LaunchError(first_line(cause)) from error
