"""The stage that plays a chunk tick by tick: acting is one program, the walkers are any pool's."""

import dataclasses
from collections.abc import Iterator

import chex
import jax
import numpy as np

from hitl_jax.config import RunHyper
from hitl_jax.envs import Command, StepBatch, WalkerPool
from hitl_jax.team.agent import Agent
from hitl_jax.training import batch_arrays
from hitl_jax.training.batch_arrays import PackedBehavior
from hitl_jax.training.learner_queue import LearnerQueue
from hitl_jax.training.stage import Slots, Tick
from hitl_jax.xla import full_registers
from hitl_jax.xla.devices import acting_device


@dataclasses.dataclass
class _HostTick:
    decided: np.ndarray
    pool: WalkerPool
    slots: Slots
    columns: slice

    def answer(self, live: np.ndarray) -> StepBatch:
        slots = self.slots
        command = np.where(live, Command.STEP, Command.IDLE).astype(np.uint8)
        command[slots.active & slots.needs_reset] = Command.RESET
        return self.pool.step(command, self.decided[:, self.columns], slots.seeds[:, 0])


class HostStage:
    """Acting is one program a tick on a device of its own; walkers are any pool's."""

    runs_ahead = False

    def __init__(self, agent: Agent, pool: WalkerPool, learner: LearnerQueue):
        """Places acting on its device; without runs yet."""
        self._pool = pool
        self._programs = learner.programs
        self._action = agent.layout.action
        self._device = acting_device()
        self._acting = batch_arrays.empty_acting(agent, pool.num_walkers, self._device)
        self._rows = len(self._acting.state)

    def prepare(self, parameters: list[PackedBehavior]) -> None:
        """See `Stage`."""
        # As the host sees them, without a copy: `jax.device_put` would take as long as unpacking.
        rows = [np.asarray(part.rows) for part in parameters]
        self._behavior = self._programs.unpack_behavior(rows, self._acting.hyper)

    def ticks(self, slots: Slots, count: int) -> Iterator[Tick]:
        """See `Stage`."""
        for _ in range(count):
            seen, live = (
                full_registers.filled(rows, self._rows) for rows in (slots.observation, slots.live)
            )
            self._acting, packed = self._programs.act(self._acting, self._behavior, seen, live)
            decided = np.asarray(packed)[: self._pool.num_walkers]
            yield _HostTick(decided, self._pool, slots, self._action)

    def begin_run(self, slot: int, hyper: RunHyper, key: chex.PRNGKey) -> None:
        """See `Stage`."""
        key = jax.device_put(key, self._device)
        self._acting = self._programs.begin_acting(self._acting, slot, hyper, key)

    def words(self) -> np.ndarray:
        """See `Stage`."""
        return np.asarray(self._acting.state)[: self._pool.num_walkers]

    def restore(self, slot: int, words: np.ndarray) -> None:
        """See `Stage`."""
        self._acting = self._programs.restore_acting(self._acting, slot, words)

    def boundaries(self) -> np.ndarray:
        """See `Stage`."""
        return np.asarray(self._programs.boundaries(self._acting))[: self._pool.num_walkers]
