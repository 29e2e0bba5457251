"""What a tick of a run decided, packed into one row: a frame of the replay, then flags."""

import functools

import chex
import jax
import jax.numpy as jnp

from hitl_jax.config import RunHyper
from hitl_jax.learner.replay import Layout
from hitl_jax.team.acting import ActingState, act, begin_episode
from hitl_jax.team.agent import Agent
from hitl_jax.types import Behavior

EXTRA_COLUMNS = ("control", "began", "human_action", "human_reset", "alarmed", "dangerous")
"""Columns of a packed decision behind those of the frame, in this order; each 0 or 1."""

CHECKED_COLUMNS = ("action", "boundary")
"""Of what was decided; a run ends where one of them is not finite. (An observation is looked at as
it comes.)"""


def act_or_begin(
    agent: Agent,
    hyper: RunHyper,
    params: Behavior,
    state: ActingState,
    observation: chex.Array,
    live: chex.Array,
) -> tuple[ActingState, chex.Array]:
    """One tick of one run: a step where it is live, else the forgetting before an episode.

    Args:
        agent: the team.
        hyper: scalars.
        params: what acting needs.
        state: the acting state.
        observation: s_t, [O].
        live: whether a step is taken at this tick, bool [].

    Returns:
        The next acting state, and the packed frame with the decision behind it, [W + 6]: without
        the reward and the endings, which the plant has yet to tell.
    """
    stepped, decision = act(agent, hyper, params, state, observation)
    begun = begin_episode(agent, state)
    state = jax.tree.map(functools.partial(jnp.where, live), stepped, begun)
    zero = jnp.zeros((), jnp.float32)
    scalars = [zero, zero, zero, jnp.float32(1.0) - live, decision.boundary, decision.next_boundary]
    scalars += [decision.boundary_reward, *(getattr(decision, name) for name in EXTRA_COLUMNS)]
    tail = jnp.stack([jnp.asarray(value, jnp.float32) for value in scalars])
    return state, jnp.concatenate([observation, decision.action, tail])


def flag_of(rows: chex.Array, layout: Layout, name: str) -> chex.Array:
    """One of `EXTRA_COLUMNS`, bool [...], from what acting gave, [..., W + 6]."""
    return rows[..., layout.width + EXTRA_COLUMNS.index(name)] > 0.5


def flags_of(rows: chex.Array, layout: Layout) -> dict[str, chex.Array]:
    """All of `EXTRA_COLUMNS` by name, see `flag_of`."""
    return {name: flag_of(rows, layout, name) for name in EXTRA_COLUMNS}
