"""A chunk of ticks as one program on the device: acting, walkers and all between them."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import batch, decisions
from hitl_jax.agent import Agent
from hitl_jax.batch import Programs
from hitl_jax.config import RunHyper
from hitl_jax.envs import Command, StepBatch
from hitl_jax.envs.jax_pool import Block, JaxPool, tick
from hitl_jax.stages import Slots, Tick
from hitl_jax.types import Behavior


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
    finite, by the same rules as the host loop, which books the chunk afterwards.
    """

    def __init__(self, agent: Agent, pool: JaxPool, programs: Programs):
        """Places acting beside the walkers; without runs yet."""
        self._pool = pool
        self._programs = programs
        self._acting = [
            batch.empty_acting(agent, block.stop - block.start, block.device)
            for block in pool.blocks
        ]
        self._behavior: list[Behavior] = []
        self._play = jax.jit(
            functools.partial(_play, agent), static_argnums=0, donate_argnums=(1, 3)
        )
        self._finite = jax.jit(lambda packed: jnp.isfinite(packed).all(axis=1))

    def prepare(self, packed: list[jax.Array]) -> np.ndarray:
        """See `Stage`."""
        # Not in the program of the ticks: its rounding would tell how many runs there are.
        self._behavior = [
            self._programs.unpack_behavior([_rows_of(packed, block)]) for block in self._pool.blocks
        ]
        return np.concatenate([np.asarray(self._finite(rows)) for rows in packed])

    def ticks(self, slots: Slots, count: int) -> Iterator[Tick]:
        """See `Stage`."""
        parts = []
        for index, block in enumerate(self._pool.blocks):
            known = jax.tree.map(
                lambda leaf, block=block: leaf[block.start : block.stop], dataclasses.astuple(slots)
            )
            acting, walkers = self._acting[index], self._pool.walkers[index]
            state, self._pool.walkers[index], ticks = self._play(
                count,
                acting.state,
                acting.hyper,
                walkers,
                self._behavior[index],
                jax.device_put(known, block.device),
            )
            self._acting[index] = acting._replace(state=state)
            parts.append(ticks)
        told = [
            np.concatenate(leaves, axis=1) for leaves in zip(*jax.device_get(parts), strict=True)
        ]
        for decided, live, *played in zip(*told, strict=True):
            yield _DeviceTick(decided, StepBatch(*played), live)

    def seat(self, slot: int, hyper: RunHyper, key: chex.PRNGKey) -> None:
        """See `Stage`."""
        index, row = self._place(slot)
        key = jax.device_put(key, self._pool.blocks[index].device)
        self._acting[index] = self._programs.seat_acting(self._acting[index], row, hyper, key)

    def words(self) -> np.ndarray:
        """See `Stage`."""
        return np.concatenate([np.asarray(acting.state) for acting in self._acting])

    def restore(self, slot: int, words: np.ndarray) -> None:
        """See `Stage`."""
        index, row = self._place(slot)
        self._acting[index] = self._programs.restore_acting(self._acting[index], row, words)

    def boundaries(self) -> np.ndarray:
        """See `Stage`."""
        return np.concatenate([np.asarray(self._programs.boundaries(a)) for a in self._acting])

    def _place(self, slot: int) -> tuple[int, int]:
        """The block of a slot and its row there."""
        for index, block in enumerate(self._pool.blocks):
            if slot < block.stop:
                return index, slot - block.start
        raise IndexError(slot)


def _rows_of(packed: Sequence[jax.Array], block: Block) -> jax.Array:
    """A block's rows of parameters that lie on the learning devices, on the block's device."""
    parts, begin = [], 0
    for rows in packed:
        start, stop = max(block.start - begin, 0), min(block.stop - begin, len(rows))
        if start < stop:
            part = rows if (start, stop) == (0, len(rows)) else rows[start:stop]
            parts.append(jax.device_put(part, block.device))
        begin += len(rows)
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)


def _play(
    agent: Agent,
    count: int,
    state: chex.Array,
    hyper: chex.Array,
    walkers: chex.ArrayTree,
    behavior: Behavior,
    known: tuple[chex.Array, ...],
) -> tuple[chex.Array, chex.ArrayTree, tuple[chex.Array, ...]]:
    """A chunk of ticks of B runs; `walkers` may be more, which stay idle.

    Args:
        agent: the team.
        count: ticks, static.
        state: acting states as words, [B, S].
        hyper: hyperparameters as words, [B, H].
        walkers: leaves [L, ...], L ≥ B.
        behavior: what acting needs of the parameters, leaves [B, ...].
        known: the fields of `Slots`, leaves [B, ...].

    Returns:
        States and walkers after it, and of each tick what was decided [U, B, W + 6], who took a
        step [U, B], and the fields of `StepBatch`.
    """
    act = jax.vmap(functools.partial(batch.act_packed, agent))
    active, needs_reset, seeds, left, observation = known
    begun = jnp.zeros_like(left)
    checked_columns = [getattr(agent.layout, name) for name in decisions.CHECKED_COLUMNS]

    def one(carry: Any, _: None) -> tuple[Any, tuple[chex.Array, ...]]:
        state, walkers, active, needs_reset, left, begun, observation = carry
        live = active & ~needs_reset
        state, decided = act(state, hyper, behavior, observation, live)
        checked = jnp.column_stack([decided[:, columns] for columns in checked_columns])
        sound = jnp.isfinite(checked).all(axis=1) | ~live
        active, live = active & sound, live & sound
        begins = active & needs_reset
        seed = jnp.take_along_axis(seeds, begun[:, None], axis=1, mode="clip")[:, 0]
        command = jnp.where(live, Command.STEP, jnp.where(begins, Command.RESET, Command.IDLE))
        action = decided[:, agent.layout.action]
        walkers, step = tick(walkers, *_padded((command, action, seed), walkers))
        step = jax.tree.map(lambda leaf: leaf[: len(live)], step)
        observation = jnp.where((live | begins)[:, None], step.observation, observation)
        reward = jnp.where(live, step.reward, 0.0)
        active = active & jnp.isfinite(reward)
        human_reset = decisions.flags_of(decided, agent.layout)["human_reset"]
        terminated, truncated = live & step.terminated, live & step.truncated
        ended = live & (terminated | truncated | human_reset)
        left = left - ended
        told = decided, live, observation, reward, terminated, truncated
        carry = state, walkers, active & (left > 0), ended, left, begun + ended, observation
        return carry, told

    carry: Any = state, walkers, active, needs_reset, left, begun, observation
    (state, walkers, *_), told = jax.lax.scan(one, carry, None, length=count)
    return state, walkers, told


def _padded(rows: tuple[chex.Array, ...], walkers: chex.ArrayTree) -> list[chex.Array]:
    """Rows of B runs with zeros behind them, one for each walker."""
    lanes = len(jax.tree.leaves(walkers)[0])
    return [jnp.pad(r, [(0, lanes - len(r))] + [(0, 0)] * (r.ndim - 1)) for r in rows]
