"""What a run is: its specification, its record while it runs, and its results."""

import dataclasses
import math
import time
import zlib
from typing import NamedTuple

import numpy as np

from hitl_jax.choices.checks import MOST_SEED, is_whole, one_of, require_whole
from hitl_jax.choices.fields import checked_by, number, require_fields, whole
from hitl_jax.config import Method, RunHyper, validate_hyper
from hitl_jax.errors import InvalidValue
from hitl_jax.human import UNLIMITED
from hitl_jax.results.diagnostic_table import COUNTERS
from hitl_jax.results.episode_measures import Row, fall_at_once
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.parts import as_tested
from hitl_jax.types import Behavior, Params
from hitl_jax.xla.devices import learning_devices

_MOST_FRAMES = 2**30
_MOST_UPDATES = 1000.0


def _with_chunk(name: str, value: int) -> None:
    """A capacity's least value depends on the chunk: `LoopConfig` checks it when it has both."""


@dataclasses.dataclass(frozen=True)
class LoopConfig:
    """How much a run plays and learns.

    Attributes:
        capacity: frames in the replay of a run; rounded up to whole chunks.
        chunk: ticks between two calls of the learner; a tick is an environment step, or the reset
            after an episode. The boundary learner makes four updates a call with `margin`, one
            with `printed` (the paper: one a step).
        updates_per_step: updates of the task learner per tick.
    """

    capacity: int = checked_by(200_000, _with_chunk)
    chunk: int = whole(16, 1, _MOST_FRAMES // 2)
    updates_per_step: float = number(0.5, 0.0, _MOST_UPDATES)

    def __post_init__(self) -> None:
        """Checks every number; InvalidValue names it, its value and what is allowed."""
        require_fields(self)
        least = 2 * self.chunk
        if is_whole(self.capacity) and self.capacity < least:
            why = f"must be at least {least}, twice chunk"
            raise InvalidValue("capacity", self.capacity, why, mentions=("chunk",))
        require_whole("capacity", self.capacity, least, _MOST_FRAMES)

    @property
    def frames(self) -> int:
        """Capacity in whole chunks."""
        return math.ceil(self.capacity / self.chunk) * self.chunk

    def require_n_step(self, n_step: int) -> None:
        """Refuses returns of so many steps that the replay has too few of them.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        if n_step > self.frames // 2:
            why = f"must be at most {self.frames // 2}, half of capacity"
            raise InvalidValue("n_step", n_step, why, mentions=("capacity",))

    def require_frames(self, least: int, boundary_learner: str) -> None:
        """Refuses a replay that is too small for a boundary learner.

        Args:
            least: frames that it needs.
            boundary_learner: its name.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        if self.frames < least:
            why = f"must be at least {least} with boundary_learner {boundary_learner}"
            raise InvalidValue("capacity", self.capacity, why, mentions=("boundary_learner",))

    def num_updates(self, policy_delay: int) -> int:
        """Updates in one call of the learner.

        Raises:
            InvalidValue: if a chunk has no whole number of delayed actor updates.
        """
        updates = self.chunk * self.updates_per_step
        if updates != round(updates) or round(updates) % policy_delay:
            raise InvalidValue(
                "updates_per_step",
                self.updates_per_step,
                f"times chunk {self.chunk} it must be a multiple of {policy_delay}, the learner's "
                "policy delay",
                mentions=("chunk",),
            )
        return round(updates)


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """A run is its method and seed; `hyper` is what the method makes of the options.

    Attributes:
        method: which method.
        seed: which seed.
        hyper: hyperparameters, host scalars.
        episodes: training episodes after which the run is done.
        snapshots: rising numbers of training episodes at which a `Snapshot` is kept.
        setting: tells runs of one method and seed apart, see `RunKey`.

    Raises:
        InvalidValue: one line with the field, its value and what is allowed.
    """

    method: Method
    seed: int
    hyper: RunHyper
    episodes: int
    snapshots: tuple[int, ...] = ()
    setting: str = ""

    def __post_init__(self) -> None:
        """Checks every field; InvalidValue names it, its value and what is allowed."""
        one_of("method", self.method, tuple(Method))
        require_whole("seed", self.seed, at_most=MOST_SEED)
        require_whole("episodes", self.episodes, at_least=1)
        before = 0
        for episode in self.snapshots:
            require_whole("snapshots", episode, before + 1, self.episodes)
            before = int(episode)
        # What is too long for the human that acts, acting cuts down: nobody's human is known here.
        validate_hyper(self.hyper, max_delay=UNLIMITED)
        assert self.key

    @property
    def key(self) -> RunKey:
        """Its name."""
        return RunKey(str(self.method), self.seed, self.setting)


class Snapshot(NamedTuple):
    """What would be tested if a run ended at one point of its training.

    Attributes:
        episode: training episodes that the run would have had; it is taken at the end of the chunk
            in which the last of them ends.
        behavior: parameters, as NumPy arrays, with what is tested as `actor`.
        boundary: the boundary source's carry, [] or [C].
    """

    episode: int
    behavior: Behavior
    boundary: np.ndarray


class Divergence(NamedTuple):
    """Where a run's numbers turned not finite; it ended there.

    Attributes:
        quantity: what was seen first: `parameters`, `observation`, `action`, `boundary`, `reward`.
        env_steps: environment steps taken until then.
        episodes: training episodes that had ended by then.
    """

    quantity: str
    env_steps: int
    episodes: int

    def __str__(self) -> str:
        return f"{self.quantity} not finite after {self.env_steps:,} steps"


@dataclasses.dataclass
class Run:
    """A run under way or done.

    Attributes:
        spec: which run.
        slot: its column in the batch.
        episodes: a row for each training episode that has ended.
        ticks: ticks that it has taken, those before it was saved and taken up again included.
        env_steps: environment steps taken.
        updates: updates of the task learner.
        done: whether all episodes have ended, or it diverged.
        snapshots: those that are due so far.
        recordings: episodes to be played again, by name; see `hitl_jax.results.recorded_episodes`.
        diverged: where its numbers turned not finite, if they did.
        diagnostics: a row for each sample of its learners; see `team.diagnostics`.
        started: when it would have begun, had it never been stopped, on the monotonic clock [s].
    """

    spec: RunSpec
    slot: int
    episodes: list[Row] = dataclasses.field(default_factory=list)
    ticks: int = 0
    env_steps: int = 0
    updates: int = 0
    done: bool = False
    snapshots: list[Snapshot] = dataclasses.field(default_factory=list)
    recordings: dict[str, Recording] = dataclasses.field(default_factory=dict)
    diverged: Divergence | None = None
    diagnostics: list[Row] = dataclasses.field(default_factory=list)
    started: float = dataclasses.field(default_factory=time.monotonic)

    def counters(self) -> Row:
        """How far the run is, by the names of `diagnostic_table.COUNTERS`."""
        return dict(zip(COUNTERS, (self.updates, self.env_steps, len(self.episodes)), strict=True))

    def all_episodes(self) -> list[Row]:
        """A row for each training episode; of a run that diverged those not played are falls."""
        rows = list(self.episodes)
        steps = self.env_steps
        for episode in range(len(rows) + 1, self.spec.episodes + 1 if self.diverged else 0):
            steps += 1
            rows.append({"episode": episode, "env_steps": steps, **fall_at_once()})
        return rows


@dataclasses.dataclass(frozen=True)
class FinishedRun:
    """What a run leaves behind.

    Attributes:
        run: its record.
        train: its training state, as NumPy arrays.
        boundary: the boundary source's carry, [] or [K].
    """

    run: Run
    train: Params
    boundary: np.ndarray

    @property
    def kept(self) -> Params:
        """`train`, with what is tested as the learner's `actor`."""
        return as_tested(self.train)


def num_slots(num_runs: int, most: int) -> int:
    """Slots for `num_runs` runs: a power of two, or `most`, rounded up to fill every device.

    Few sizes, so that programs compiled for one number of runs serve others. An empty slot costs
    memory and a little acting, no learning. At least two a device: of an axis of one XLA makes
    another program, which rounds otherwise, and a run's numbers would tell that it was alone.

    Args:
        num_runs: how many runs there are, at least 1.
        most: how many are wanted at a time, at least 1.
    """
    require_whole("runs", num_runs, at_least=1)
    require_whole("slots", most, at_least=1)
    devices = len(learning_devices())
    power = 2 ** math.ceil(math.log2(num_runs))
    return max(math.ceil(min(power, most) / devices), 2) * devices


def method_index(method: Method) -> int:
    """A number for a method that does not depend on which methods run."""
    return list(Method).index(method)


def episode_seed(*parts: object) -> int:
    """A reset seed from (method, seed, episode number), or any other words, 32 bits."""
    return zlib.crc32("/".join(str(part) for part in parts).encode())
