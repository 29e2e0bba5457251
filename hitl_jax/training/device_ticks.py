"""A chunk of ticks as one program on the device: acting, walkers, and the end-of-step rule."""

import dataclasses
import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.envs import Command, StepBatch
from hitl_jax.envs.jax_pool import tick
from hitl_jax.learner.frame import Layout
from hitl_jax.training.stage import Slots
from hitl_jax.training.step_booking import end_of_step, finite_decision

Act = Callable[[Any, chex.Array, chex.Array], tuple[Any, chex.Array]]
"""From acting states, what is seen [L, O] and who takes a step, bool [L], to the next states and
what was decided, [L, W + 6]."""


class ChunkStart(NamedTuple):
    """What L walkers begin a chunk with, or end it with; `Slots` says what its fields are."""

    active: chex.Array
    needs_reset: chex.Array
    left: chex.Array
    observation: chex.Array


def begins_with(slots: Slots) -> tuple[ChunkStart, np.ndarray, np.ndarray]:
    """What `play` is given where a chunk begins with what the host has booked: copies."""
    own = dataclasses.asdict(slots)
    begin = ChunkStart(*(own[name] for name in ChunkStart._fields))
    return begin, own["seeds"], own["left"]


def play(
    act: Act,
    layout: Layout,
    count: int,
    state: chex.ArrayTree,
    walkers: chex.ArrayTree,
    begin: ChunkStart,
    seeds: chex.Array,
    first_left: chex.Array,
) -> tuple[chex.ArrayTree, chex.ArrayTree, ChunkStart, tuple[chex.Array, ...]]:
    """Ticks of L walkers.

    Ends episodes, begins the next ones and stops what is done or not finite, by the same rules as
    the host, which books the chunk afterwards.

    Args:
        act: decides a tick.
        layout: columns of what it decides.
        count: ticks, static.
        state: acting states.
        walkers: leaves [L, ...].
        begin: what it begins with.
        seeds: of resets to come, uint32 [L, K].
        first_left: episodes that a run has yet to end when the first of these is due, int32 [L].

    Returns:
        States and walkers after it, what it ends with, and of each tick what was decided
        [U, L, W + 6], who took a step [U, L], and the fields of `StepBatch`.
    """

    def one(carry: Any, _: None) -> tuple[Any, tuple[chex.Array, ...]]:
        state, walkers, (active, needs_reset, left, observation) = carry
        live = active & ~needs_reset
        state, decided = act(state, observation, live)
        sound = functools.reduce(operator.and_, finite_decision(decided, layout).values()) | ~live
        active, live = active & sound, live & sound
        begins = active & needs_reset
        due = (first_left - left)[:, None]
        seed = jnp.take_along_axis(seeds, due, axis=1, mode="clip")[:, 0]
        command = jnp.where(live, Command.STEP, jnp.where(begins, Command.RESET, Command.IDLE))
        walkers, step = tick(walkers, command, decided[:, layout.action], seed)
        told: dict[str, Any] = {
            "observation": jnp.where((live | begins)[:, None], step.observation, observation),
            "reward": jnp.where(live, step.reward, 0.0),
            "terminated": live & step.terminated,
            "truncated": live & step.truncated,
        }
        answer = StepBatch(**told)  # Of JAX's arrays.
        end = end_of_step(decided, answer, layout, live, begins)
        active, left = active & end.sound, left - end.ended
        begin = ChunkStart(active & (left > 0), end.ended, left, answer.observation)
        return (state, walkers, begin), (decided, live, *answer)

    carry, told = jax.lax.scan(one, (state, walkers, begin), None, length=count)
    return *carry, told
