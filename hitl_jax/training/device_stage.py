"""The stage whose walkers are on the device: a chunk of ticks is one program."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import RunHyper
from hitl_jax.envs import StepBatch
from hitl_jax.envs.jax_pool import Block, JaxPool
from hitl_jax.learner.replay import Replay
from hitl_jax.team.agent import Agent
from hitl_jax.training import batch_arrays, compiled_batch, device_ticks
from hitl_jax.training.batch_arrays import PackedBehavior
from hitl_jax.training.device_ticks import ChunkStart, begins_with
from hitl_jax.training.learn_batch import learn_all
from hitl_jax.training.learner_queue import LearnerQueue
from hitl_jax.training.stage import Slots, Tick
from hitl_jax.types import Behavior
from hitl_jax.xla import full_registers
from hitl_jax.xla.devices import learning_devices

_Played = tuple[chex.ArrayTree, chex.ArrayTree, ChunkStart, tuple[chex.Array, ...]]
"""What `device_ticks.play` gives."""


@dataclasses.dataclass
class _DeviceTick:
    decided: np.ndarray
    played: StepBatch
    live: np.ndarray

    def answer(self, live: np.ndarray) -> StepBatch:
        if not np.array_equal(live, self.live):
            raise RuntimeError("host and device disagree on who takes a step: please report this")
        return self.played


class DeviceStage:
    """Acting and walkers share one program for a whole chunk, on each block of the pool's walkers.

    The pool itself is not told what its walkers do here: it may but RESET them, and go on from
    there. The program ends episodes, begins the next ones and stops runs that are done or not
    finite, by the same rules as the host loop, which books the chunk afterwards. The next one is
    played while it does.

    Where the same accelerator learns, a chunk and a call of the learner are one program: neither
    needs what the other gives, and the GPU works on both at once. A chunk alone is a few thousand
    small kernels, one after the other, which leave most of a GPU idle.
    """

    runs_ahead = True

    def __init__(self, agent: Agent, pool: JaxPool, learner: LearnerQueue):
        """Places acting beside the walkers; without runs yet."""
        self._pool = pool
        self._learner = learner
        self._programs = learner.programs
        devices = [block.device for block in pool.blocks]
        learner.defers = len(devices) == 1 and devices == list(learning_devices())
        self._acting = [
            batch_arrays.empty_acting(agent, pool.lanes, block.device) for block in pool.blocks
        ]
        self._behavior: list[tuple[Behavior, list[jax.Array]]] = []
        self._starts: list[ChunkStart] = []
        self._unbooked = 0
        self._boundaries: np.ndarray | None = None
        self._play = jax.jit(
            functools.partial(_play, agent), static_argnums=0, donate_argnums=(1, 3)
        )
        self._play_and_learn = jax.jit(
            functools.partial(_play_and_learn, agent, learner.num_updates, learner.tile),
            static_argnums=0,
            donate_argnums=(1, 3, 5),
        )

    def prepare(self, parameters: list[PackedBehavior]) -> None:
        """See `Stage`."""
        lanes = self._pool.lanes
        rows, finite = zip(*parameters, strict=True)
        # Not in the program of the ticks: its rounding would tell how many runs there are.
        self._behavior = [
            (
                self._programs.unpack_behavior(_rows_of(rows, block, lanes)),
                _rows_of(finite, block, lanes),
            )
            for block in self._pool.blocks
        ]

    def ticks(self, slots: Slots, count: int) -> Iterator[Tick]:
        """See `Stage`."""
        if self._unbooked > 1:
            raise RuntimeError("no chunk can be begun while two are not booked")
        given = begins_with(slots)
        parts, boundaries, starts = [], [], []
        for index, block in enumerate(self._pool.blocks):
            own = slice(block.start, block.stop)
            rows = jax.tree.map(
                lambda a, own=own: full_registers.filled(a[own], self._pool.lanes), given
            )
            begin, *others = jax.device_put(rows, block.device)
            acting, walkers = self._acting[index], self._pool.walkers[index]
            state, self._pool.walkers[index], start, ticks = self._played(
                count,
                acting.state,
                acting.hyper,
                walkers,
                (
                    *self._behavior[index],
                    self._starts[index] if self._unbooked else begin,
                    *others,
                ),
            )
            self._acting[index] = acting._replace(state=state)
            parts.append(ticks)
            boundaries.append(self._programs.boundaries(self._acting[index]))
            starts.append(start)
        self._starts = starts
        self._unbooked += 1
        return self._told(parts, boundaries)

    def _played(self, *given: Any) -> _Played:
        """A chunk of a block; the learner's call, if one waits, is made beside it."""
        call = self._learner.take()
        if call is None:
            return self._play(*given)
        batch, *rest = call
        before = batch.train, batch.memory
        played, (train, memory), learned = self._play_and_learn(*given, before, batch.hyper, *rest)
        self._learner.give(batch._replace(train=train, memory=memory), learned)
        return played

    def _told(
        self, parts: list[tuple[chex.Array, ...]], boundaries: list[chex.Array]
    ) -> Iterator[Tick]:
        """Waits for a chunk's ticks, and gives them."""
        told = [
            self._of_runs(leaves, axis=1) for leaves in zip(*jax.device_get(parts), strict=True)
        ]
        for decided, live, *played in zip(*told, strict=True):
            yield _DeviceTick(decided, StepBatch(*played), live)
        self._boundaries = self._of_runs(jax.device_get(boundaries))
        self._unbooked -= 1

    def begin_run(self, slot: int, hyper: RunHyper, key: chex.PRNGKey) -> None:
        """See `Stage`."""
        index, row = self._place(slot)
        key = jax.device_put(key, self._pool.blocks[index].device)
        self._acting[index] = self._programs.begin_acting(self._acting[index], row, hyper, key)

    def words(self) -> np.ndarray:
        """See `Stage`."""
        return self._of_runs([np.asarray(acting.state) for acting in self._acting])

    def restore(self, slot: int, words: np.ndarray) -> None:
        """See `Stage`."""
        index, row = self._place(slot)
        self._acting[index] = self._programs.restore_acting(self._acting[index], row, words)

    def boundaries(self) -> np.ndarray:
        """See `Stage`."""
        if self._unbooked:
            assert self._boundaries is not None
            return self._boundaries
        return self._of_runs([np.asarray(self._programs.boundaries(a)) for a in self._acting])

    def _of_runs(self, parts: Sequence[np.ndarray], axis: int = 0) -> np.ndarray:
        """One array of all runs from those of the blocks, whose axis has a row for each lane."""
        before = (slice(None),) * axis
        own = [
            part[*before, : block.stop - block.start]
            for part, block in zip(parts, self._pool.blocks, strict=True)
        ]
        return own[0] if len(own) == 1 else np.concatenate(own, axis)

    def _place(self, slot: int) -> tuple[int, int]:
        """The block of a slot and its row there."""
        for index, block in enumerate(self._pool.blocks):
            if slot < block.stop:
                return index, slot - block.start
        raise IndexError(slot)


def _rows_of(packed: Sequence[jax.Array], block: Block, count: int) -> list[jax.Array]:
    """A block's rows of parameters that lie on the learning devices, on the block's device.

    Rows of zeros follow where `unpack_behavior` would not fill them up to `count`.
    """
    parts, begin = [], 0
    for rows in packed:
        start, stop = max(block.start - begin, 0), min(block.stop - begin, len(rows))
        if start < stop:
            part = rows if (start, stop) == (0, len(rows)) else rows[start:stop]
            parts.append(jax.device_put(part, block.device))
        begin += len(rows)
    own = block.stop - block.start
    if full_registers.full(own) < count:
        behind = (count - own, *parts[0].shape[1:])
        parts.append(jnp.zeros(behind, parts[0].dtype, device=block.device))
    return parts


def _play(
    agent: Agent,
    count: int,
    state: chex.Array,
    hyper: chex.Array,
    walkers: chex.ArrayTree,
    rest: tuple[Behavior, Sequence[chex.Array], ChunkStart, chex.Array, chex.Array],
) -> _Played:
    """A chunk of ticks of runs on L lanes; see `device_ticks.play`.

    Args:
        agent: the team.
        count: ticks, static.
        state: acting states as words, [L, S].
        hyper: hyperparameters as words, [L, H].
        walkers: leaves [L, ...].
        rest: what acting needs of the parameters, leaves [L, ...]; whether a run's parameters are
            finite, bool [..], in parts; what the chunk begins with; seeds of resets to come, uint32
            [L, K]; episodes left when the first of these is due, int32 [L].
    """
    behavior, finite, begin, seeds, first_left = rest
    runs = jax.vmap(functools.partial(compiled_batch.act_packed, agent))

    def act(
        state: chex.Array, observation: chex.Array, live: chex.Array
    ) -> tuple[chex.Array, chex.Array]:
        after, decided = runs(state, hyper, behavior, observation, live)
        return after, decided

    of_all = jnp.concatenate(finite)
    of_all = jnp.pad(of_all, (0, len(begin.active) - len(of_all)))
    begin = begin._replace(active=begin.active & of_all)
    return device_ticks.play(act, agent.layout, count, state, walkers, begin, seeds, first_left)


def _play_and_learn(
    agent: Agent,
    num_updates: int,
    tile: int,
    count: int,
    state: chex.Array,
    hyper: chex.Array,
    walkers: chex.ArrayTree,
    rest: Any,
    before: tuple[chex.Array, Replay],
    *learns: chex.Array,
) -> tuple[_Played, tuple[chex.Array, Replay], PackedBehavior]:
    """What `_play` and `learn_batch.learn_all` give."""
    played = _play(agent, count, state, hyper, walkers, rest)
    return played, *learn_all(agent, num_updates, tile, before, *learns)
