"""A chunk of ticks as one program on the device: acting, walkers and all between them."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.envs import Command
from hitl_jax.envs.jax_pool import tick
from hitl_jax.learner.replay import Layout
from hitl_jax.team import packed_decision
from hitl_jax.training.stage import Slots

Act = Callable[[Any, chex.Array, chex.Array], tuple[Any, chex.Array]]
"""From acting states, what is seen [L, O] and who takes a step, bool [L], to the next states and
what was decided, [L, W + 6]."""


class Moment(NamedTuple):
    """What L walkers begin a chunk with, or end it with; `Slots` says what its fields are."""

    active: chex.Array
    needs_reset: chex.Array
    left: chex.Array
    observation: chex.Array


def begins_with(slots: Slots) -> tuple[Moment, np.ndarray, np.ndarray]:
    """What `play` is given where a chunk begins with what the host has booked: copies."""
    own = dataclasses.asdict(slots)
    begin = Moment(*(own[name] for name in Moment._fields))
    return begin, own["seeds"], own["left"]


def play(
    act: Act,
    layout: Layout,
    count: int,
    state: chex.ArrayTree,
    walkers: chex.ArrayTree,
    begin: Moment,
    seeds: chex.Array,
    first_left: chex.Array,
) -> tuple[chex.ArrayTree, chex.ArrayTree, Moment, tuple[chex.Array, ...]]:
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
    checked_columns = [getattr(layout, name) for name in packed_decision.CHECKED_COLUMNS]

    def one(carry: Any, _: None) -> tuple[Any, tuple[chex.Array, ...]]:
        state, walkers, (active, needs_reset, left, observation) = carry
        live = active & ~needs_reset
        state, decided = act(state, observation, live)
        checked = jnp.column_stack([decided[:, columns] for columns in checked_columns])
        sound = jnp.isfinite(checked).all(axis=1) | ~live
        active, live = active & sound, live & sound
        begins = active & needs_reset
        due = (first_left - left)[:, None]
        seed = jnp.take_along_axis(seeds, due, axis=1, mode="clip")[:, 0]
        command = jnp.where(live, Command.STEP, jnp.where(begins, Command.RESET, Command.IDLE))
        action = decided[:, layout.action]
        walkers, step = tick(walkers, command, action, seed)
        observation = jnp.where((live | begins)[:, None], step.observation, observation)
        reward = jnp.where(live, step.reward, 0.0)
        active = active & jnp.isfinite(reward) & jnp.isfinite(observation).all(axis=1)
        human_reset = packed_decision.flag_of(decided, layout, "human_reset")
        terminated, truncated = live & step.terminated, live & step.truncated
        ended = live & (terminated | truncated | human_reset)
        left = left - ended
        told = decided, live, observation, reward, terminated, truncated
        return (state, walkers, Moment(active & (left > 0), ended, left, observation)), told

    carry, told = jax.lax.scan(one, (state, walkers, begin), None, length=count)
    return *carry, told
