"""The host loop's learner: all runs on the learning devices, and calls not yet finished."""

import dataclasses
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import chex
import jax
import numpy as np

from hitl_jax.config import RunHyper
from hitl_jax.learner.losses import Metrics
from hitl_jax.team import agent as agents
from hitl_jax.team.agent import Agent
from hitl_jax.training import batch_arrays, compiled_batch
from hitl_jax.training.batch_arrays import LearnerBatch, PackedBehavior
from hitl_jax.training.run_spec import LoopConfig
from hitl_jax.types import Behavior, TrainState
from hitl_jax.xla.devices import default_tile, learning_devices
from hitl_jax.xla.pytree_words import unpack_on_host, word_places

LAG = 2
"""Calls of the learner that may be under way while the walkers play; see `rollout`."""


class LearnerCall(NamedTuple):
    """A call of the learner that has not been started; see `Programs.learn`.

    Attributes:
        batch: what learns.
        frames: to be added to the replay first, [R, U, W].
        slots: of the runs that learn, int32 [R].
        num_slots: how many they are.
    """

    batch: LearnerBatch
    frames: np.ndarray
    slots: np.ndarray
    num_slots: np.int32


class LearnerQueue:
    """R slots, an equal share of them on each learning device.

    Attributes:
        programs: of the batch.
        num_updates: updates of the task learner in a call.
        tile: runs that are learned at once.
        defers: whether a call waits for a stage that `take`s it; it is started without one as soon
            as somebody asks for what it changes.
    """

    defers = False

    def __init__(self, agent: Agent, config: LoopConfig, slots: int, cursor: int):
        """Places empty batches on the devices.

        Args:
            agent: the team.
            config: the size of the replay and of a call.
            slots: R, a multiple of the devices' number.
            cursor: frames that each ring counts as written.
        """
        devices = learning_devices()
        self.num_updates = config.num_updates(agent.learner.policy_delay)
        self.tile = default_tile(slots)
        self.programs = compiled_batch.make_programs(agent, self.num_updates, self.tile)
        self._deferred: LearnerCall | None = None
        self._layout, self._frames = agent.layout, config.frames
        self._train = batch_arrays.some_train(agent)
        self._places = word_places(self._train)
        self._share = slots // len(devices)
        empty = [
            batch_arrays.empty_learner(agent, self._share, config.frames, each) for each in devices
        ]
        self._batches = [self.programs.begin_ring(batch, cursor) for batch in empty]
        self._learned = deque(
            [self.programs.pack_behavior(batch.train) for batch in self._batches]
            for _ in range(LAG + 1)
        )

    def order(self) -> list[int]:
        """All slots, such that neighbours are on different devices."""
        slots = np.arange(self._share * len(self._batches)).reshape(len(self._batches), self._share)
        return [int(slot) for slot in slots.T.ravel()]

    def begin(self, slot: int, hyper: RunHyper, key: chex.PRNGKey) -> None:
        """Begins a run.

        Args:
            slot: where.
            hyper: its hyperparameters, typed host scalars.
            key: of its learning, see `batch_arrays.run_keys`; consumed.
        """
        self._start_deferred()
        device, column = divmod(slot, self._share)
        words, row = jax.device_get(self.programs.begin(key))
        self._batches[device] = self.programs.begin_learning(
            self._batches[device], column, hyper, words
        )
        for waiting in self._learned:
            waiting[device] = self.programs.put_behavior(waiting[device], column, row)

    def restore(
        self, slot: int, words: np.ndarray, behavior: np.ndarray, frames: np.ndarray
    ) -> None:
        """Makes of a run that has begun what it was when it was saved.

        Args:
            slot: where.
            words: its row of `save`.
            behavior: the same.
            frames: of its replay, newest last, [F, W].
        """
        self._start_deferred()
        device, column = divmod(slot, self._share)
        batch = self._batches[device]
        cursor = int(batch.memory.cursor)
        ring = np.zeros((self._frames, self._layout.width), np.float32)
        frames = frames[-len(ring) :]
        start = cursor - len(frames)
        ring[np.arange(start, cursor) % len(ring)] = frames
        self._batches[device] = self.programs.restore(batch, column, words, ring, np.int32(start))
        for waiting, row in zip(self._learned, behavior, strict=True):
            waiting[device] = self.programs.put_behavior(waiting[device], column, row)

    def save(self) -> tuple[np.ndarray, np.ndarray]:
        """What `restore` takes of each run but its frames, [R, P] and [R, LAG + 1, B]; waits."""
        self._start_deferred()
        # Copies: with a view of it about, the learner could not change the array in place.
        words = np.concatenate([np.array(batch.train) for batch in self._batches])
        waiting = [np.concatenate([part.rows for part in parts]) for parts in self._learned]
        return words, np.stack(waiting, axis=1)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of a run's rows of `save`, named as in `SavedRun`."""
        self._start_deferred()
        [*_, parts] = self._learned
        return {
            "train": self._batches[0].train.shape[1:],
            "behavior": (len(self._learned), *parts[0].rows.shape[1:]),
        }

    def parameters(self) -> list[PackedBehavior]:
        """What acts in the next chunk, of each device's runs; not awaited."""
        return self._learned.popleft()

    def learn(self, frames: np.ndarray, slots: Sequence[int]) -> None:
        """Starts the learner on a chunk; does not wait for it.

        Args:
            frames: of all runs, [R, U, W].
            slots: of the runs that learn; of the others the frames are kept.
        """
        self._start_deferred()
        calls = []
        for device, batch in enumerate(self._batches):
            first = device * self._share
            columns = [slot - first for slot in slots if 0 <= slot - first < self._share]
            listed = np.zeros(self._share, np.int32)
            listed[: len(columns)] = columns
            rows = frames[first : first + self._share]
            calls.append(LearnerCall(batch, rows, listed, np.int32(len(columns))))
        if self.defers:
            [self._deferred] = calls
        else:
            self._note([self.programs.learn(*call) for call in calls])

    def take(self) -> LearnerCall | None:
        """The call that was deferred, if there is one; who takes it will `give` what it gave."""
        call, self._deferred = self._deferred, None
        return call

    def give(self, batch: LearnerBatch, learned: PackedBehavior) -> None:
        """Takes what the call gave that was taken."""
        self._note([(batch, learned)])

    def _note(self, given: Sequence[tuple[LearnerBatch, PackedBehavior]]) -> None:
        """Notes what the calls of all devices gave."""
        self._batches = [batch for batch, _ in given]
        self._learned.append([learned for _, learned in given])

    def _start_deferred(self) -> None:
        call = self.take()
        if call is not None:
            self.give(*self.programs.learn(*call))

    def diagnose(self, slots: Sequence[int]) -> Iterator[tuple[Sequence[int], Metrics]]:
        """What runs' learners are at after the calls so far, see `team.diagnostics`; not awaited.

        Args:
            slots: of runs that have learned.

        Yields:
            Some of the slots, as many as are learned at once, and their metrics, leaves [K]; those
            behind the last slot mean nothing.
        """
        if slots:
            self._start_deferred()
        for device, batch in enumerate(self._batches):
            own = [slot for slot in slots if slot // self._share == device]
            for begin in range(0, len(own), self.tile):
                some = own[begin : begin + self.tile]
                columns = np.full(self.tile, some[0] % self._share, np.int32)
                columns[: len(some)] = np.array(some) % self._share
                yield some, self.programs.diagnose(batch, columns)

    def wait(self) -> None:
        """Returns when the learner has nothing left to do."""
        self._start_deferred()
        jax.block_until_ready([batch.train for batch in self._batches])

    def train_of(self, slot: int) -> TrainState:
        """A run's training state as NumPy arrays, without its key."""
        self._start_deferred()
        device, column = divmod(slot, self._share)
        words = self.programs.row_of(self._batches[device].train, np.int32(column))
        train: TrainState = unpack_on_host(self._train, self._places, np.asarray(words))
        return dataclasses.replace(train, key=None)

    def tested_of(self, slot: int) -> chex.Array:
        """What a test needs of a run after the calls so far, a row for `behaviors`; not awaited."""
        self._start_deferred()
        device, column = divmod(slot, self._share)
        return self.programs.tested_of(self._batches[device].train, np.int32(column))

    def behaviors(self, rows: np.ndarray) -> list[Behavior]:
        """What acting needs, as NumPy arrays, from packed rows [K, B]."""
        leaves, structure = jax.tree.flatten(agents.behavior(self._train))
        ends = np.cumsum([leaf.size for leaf in leaves])
        return [
            jax.tree.unflatten(
                structure,
                [
                    part.reshape(leaf.shape)
                    for part, leaf in zip(np.split(row, ends[:-1]), leaves, strict=True)
                ],
            )
            for row in rows
        ]
