"""A chunk of ticks as one program on the device: acting, walkers and all between them."""

from collections.abc import Callable, Sequence
from typing import Any

import chex
import jax
import jax.numpy as jnp

from hitl_jax import decisions
from hitl_jax.envs import Command
from hitl_jax.envs.jax_pool import tick
from hitl_jax.replay import Layout

Act = Callable[[Any, chex.Array, chex.Array], tuple[Any, chex.Array]]
"""From acting states, what is seen [B, O] and who takes a step, bool [B], to the next states and
what was decided, [B, W + 6]."""


def play(
    act: Act,
    layout: Layout,
    count: int,
    state: chex.ArrayTree,
    walkers: chex.ArrayTree,
    known: Sequence[chex.Array],
) -> tuple[chex.ArrayTree, chex.ArrayTree, tuple[chex.Array, ...]]:
    """Ticks of B walkers; `walkers` may be more, which stay idle.

    Ends episodes, begins the next ones and stops what is done or not finite, by the same rules as
    the host, which books the chunk afterwards.

    Args:
        act: decides a tick.
        layout: columns of what it decides.
        count: ticks, static.
        state: acting states.
        walkers: leaves [L, ...], L ≥ B.
        known: the fields of `Slots`, leaves [B, ...].

    Returns:
        States and walkers after it, and of each tick what was decided [U, B, W + 6], who took a
        step [U, B], and the fields of `StepBatch`.
    """
    active, needs_reset, seeds, left, observation = known
    begun = jnp.zeros_like(left)
    checked_columns = [getattr(layout, name) for name in decisions.CHECKED_COLUMNS]

    def one(carry: Any, _: None) -> tuple[Any, tuple[chex.Array, ...]]:
        state, walkers, active, needs_reset, left, begun, observation = carry
        live = active & ~needs_reset
        state, decided = act(state, observation, live)
        checked = jnp.column_stack([decided[:, columns] for columns in checked_columns])
        sound = jnp.isfinite(checked).all(axis=1) | ~live
        active, live = active & sound, live & sound
        begins = active & needs_reset
        seed = jnp.take_along_axis(seeds, begun[:, None], axis=1, mode="clip")[:, 0]
        command = jnp.where(live, Command.STEP, jnp.where(begins, Command.RESET, Command.IDLE))
        action = decided[:, layout.action]
        walkers, step = tick(walkers, *_padded((command, action, seed), walkers))
        step = jax.tree.map(lambda leaf: leaf[: len(live)], step)
        observation = jnp.where((live | begins)[:, None], step.observation, observation)
        reward = jnp.where(live, step.reward, 0.0)
        active = active & jnp.isfinite(reward)
        human_reset = decisions.flag_of(decided, layout, "human_reset")
        terminated, truncated = live & step.terminated, live & step.truncated
        ended = live & (terminated | truncated | human_reset)
        left = left - ended
        told = decided, live, observation, reward, terminated, truncated
        carry = state, walkers, active & (left > 0), ended, left, begun + ended, observation
        return carry, told

    carry: Any = state, walkers, active, needs_reset, left, begun, observation
    (state, walkers, *_), told = jax.lax.scan(one, carry, None, length=count)
    return state, walkers, told


def _padded(rows: Sequence[chex.Array], walkers: chex.ArrayTree) -> list[chex.Array]:
    """Rows of B walkers with zeros behind them, one for each walker."""
    lanes = len(jax.tree.leaves(walkers)[0])
    return [jnp.pad(r, [(0, lanes - len(r))] + [(0, 0)] * (r.ndim - 1)) for r in rows]
