"""The learner's side of the host loop: all runs on the learning devices, and calls under way."""

import dataclasses
import operator
from collections import deque
from collections.abc import Sequence

import chex
import jax
import numpy as np

from hitl_jax.config import RunHyper
from hitl_jax.team.agent import Agent
from hitl_jax.training import compiled_batch
from hitl_jax.training.run_spec import LoopConfig
from hitl_jax.types import Behavior, TrainState
from hitl_jax.xla.devices import default_tile, learning_devices

LAG = 2
"""Calls of the learner that may be under way while the walkers play; see `rollout`."""


class LearnerSide:
    """R slots, an equal share of them on each learning device.

    Attributes:
        programs: of the batch.
        num_updates: updates of the task learner in a call.
    """

    def __init__(self, agent: Agent, config: LoopConfig, slots: int, cursor: int):
        """Places empty seats on the devices.

        Args:
            agent: the team.
            config: the size of the replay and of a call.
            slots: R, a multiple of the devices' number.
            cursor: frames that each ring counts as written.
        """
        devices = learning_devices()
        self.num_updates = config.num_updates(agent.config.task_learner.policy_delay)
        self.programs = compiled_batch.make_programs(agent, self.num_updates, default_tile(slots))
        self._layout, self._frames = agent.layout, config.frames
        self._share = slots // len(devices)
        empty = [
            compiled_batch.empty_seats(agent, self._share, config.frames, each) for each in devices
        ]
        self._seats = [self.programs.begin_ring(seats, cursor) for seats in empty]
        self._learned = deque(
            [self.programs.pack_behavior(seats.train) for seats in self._seats]
            for _ in range(LAG + 1)
        )

    def order(self) -> list[int]:
        """All slots, such that neighbours are on different devices."""
        slots = np.arange(self._share * len(self._seats)).reshape(len(self._seats), self._share)
        return [int(slot) for slot in slots.T.ravel()]

    def seat(self, slot: int, hyper: RunHyper, key: chex.PRNGKey) -> None:
        """Begins a run.

        Args:
            slot: where.
            hyper: its hyperparameters, typed host scalars.
            key: of its learning, see `compiled_batch.run_keys`; consumed.
        """
        device, column = divmod(slot, self._share)
        words, row = jax.device_get(self.programs.begin(key))
        self._seats[device] = self.programs.seat(self._seats[device], column, hyper, words)
        for waiting in self._learned:
            waiting[device] = self.programs.seat_behavior(waiting[device], column, row)

    def restore(
        self, slot: int, words: np.ndarray, behavior: np.ndarray, frames: np.ndarray
    ) -> None:
        """Makes of a run that was seated what it was when it was saved.

        Args:
            slot: where.
            words: its row of `save`.
            behavior: the same.
            frames: of its replay, newest last, [F, W].
        """
        device, column = divmod(slot, self._share)
        seats = self._seats[device]
        cursor = int(seats.memory.cursor)
        ring = np.zeros((self._frames, self._layout.width), np.float32)
        frames = frames[-len(ring) :]
        start = cursor - len(frames)
        ring[np.arange(start, cursor) % len(ring)] = frames
        self._seats[device] = self.programs.restore(seats, column, words, ring, np.int32(start))
        for waiting, row in zip(self._learned, behavior, strict=True):
            waiting[device] = self.programs.seat_behavior(waiting[device], column, row)

    def save(self) -> tuple[np.ndarray, np.ndarray]:
        """What `restore` takes of each run but its frames, [R, P] and [R, LAG + 1, B]; waits."""
        # Copies: with a view of it about, the learner could not change the array in place.
        words = np.concatenate([np.array(seats.train) for seats in self._seats])
        waiting = [np.concatenate([part.rows for part in parts]) for parts in self._learned]
        return words, np.stack(waiting, axis=1)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of a run's rows of `save`, named as in `SavedRun`."""
        [*_, parts] = self._learned
        return {
            "train": self._seats[0].train.shape[1:],
            "behavior": (len(self._learned), *parts[0].rows.shape[1:]),
        }

    def parameters(self) -> tuple[list[jax.Array], np.ndarray]:
        """What acts in the next chunk; waits for the call of the learner that gives it.

        Returns:
            Rows of each device's runs, packed, and whether a run's are finite, bool [R].
        """
        parts = self._learned.popleft()
        finite = np.concatenate([np.asarray(part.finite) for part in parts])
        return [part.rows for part in parts], finite

    def learn(self, frames: np.ndarray, slots: Sequence[int]) -> None:
        """Starts the learner on a chunk; does not wait for it.

        Args:
            frames: of all runs, [R, U, W].
            slots: of the runs that learn; of the others the frames are kept.
        """
        learned = []
        for device, seats in enumerate(self._seats):
            first = device * self._share
            columns = [slot - first for slot in slots if 0 <= slot - first < self._share]
            listed = np.zeros(self._share, np.int32)
            listed[: len(columns)] = columns
            rows = frames[first : first + self._share]
            self._seats[device], after = self.programs.learn(
                seats, rows, listed, np.int32(len(columns))
            )
            learned.append(after)
        self._learned.append(learned)

    def wait(self) -> None:
        """Returns when the learner has nothing left to do."""
        jax.block_until_ready([seats.train for seats in self._seats])

    def train_of(self, slot: int) -> TrainState:
        """A run's training state as NumPy arrays, without its key."""
        device, column = divmod(slot, self._share)
        train = self.programs.unpack_train(self._seats[device].train, column)
        fetched: TrainState = jax.device_get(dataclasses.replace(train, key=None))
        return fetched

    def behaviors(self, rows: np.ndarray) -> list[Behavior]:
        """What acting needs, as NumPy arrays, from packed rows [K, B]."""
        if not len(rows):
            return []
        several = jax.device_get(self.programs.unpack_behavior([rows]))
        return [jax.tree.map(operator.itemgetter(k), several) for k in range(len(rows))]
