"""Packs one tick of one run into a row: a step, or the reset before an episode."""

import functools

import chex
import jax
import jax.numpy as jnp

from hitl_jax.config import RunHyper
from hitl_jax.learner.frame import Flags, Frame, pack
from hitl_jax.team.acting import ActingState, act, begin_episode
from hitl_jax.team.parts import Agent
from hitl_jax.types import Behavior


def act_or_begin(
    agent: Agent,
    hyper: RunHyper,
    params: Behavior,
    state: ActingState,
    observation: chex.Array,
    live: chex.Array,
) -> tuple[ActingState, chex.Array]:
    """One tick of one run: a step where the run is live, else its per-episode state is reset.

    Args:
        agent: the team.
        hyper: scalars.
        params: what acting needs.
        state: the acting state.
        observation: s_t, [O].
        live: whether a step is taken at this tick, bool [].

    Returns:
        The next acting state, and the packed row (`learner.frame.pack`), [W + 6], without reward
        and endings, which `training.step_booking` writes when the walker has answered.
    """
    stepped, decision = act(agent, hyper, params, state, observation)
    begun = begin_episode(agent, state)
    state = jax.tree.map(functools.partial(jnp.where, live), stepped, begun)
    unknown = jnp.zeros((), jnp.float32)
    frame = Frame(
        observation=observation,
        action=decision.action,
        reward=unknown,
        terminated=unknown,
        truncated=unknown,
        final=jnp.float32(1.0) - live,
        boundary=decision.boundary,
        next_boundary=decision.next_boundary,
        boundary_reward=decision.boundary_reward,
        event=unknown,
        explores=decision.explores,
    )
    return state, pack(frame, Flags(*(getattr(decision, name) for name in Flags._fields)))
