"""A boundary learner tried once, by shapes alone: π_θ, its noise, its samples and its updates."""

import dataclasses

import jax
import jax.numpy as jnp

from hitl_jax.learner import replay
from hitl_jax.results.diagnostic_table import require_measured
from hitl_jax.team.parts import Agent
from hitl_jax.team.trial_shapes import Blamed, Given, floats
from hitl_jax.types import BoundaryState, BoundaryTransition


def state_of_boundary_learner(agent: Agent, given: Given, blamed: Blamed) -> BoundaryState:
    """Tries a team's boundary learner.

    Args:
        agent: the team.
        given: what it is called with.
        blamed: the learner, for messages.

    Returns:
        Its state, as shapes.

    Raises:
        InvalidValue: one line with the learner and what is wrong with it.
    """
    learner, config, hyper = agent.boundary_learner, agent.config, given.hyper
    state: BoundaryState = blamed.shapes(learner.init, given.key, given.key)
    if not isinstance(state, BoundaryState):
        raise blamed.refuse("init must give a BoundaryState")
    boundary = blamed.shapes(learner.boundary, hyper, state.actor, given.seen)
    blamed.require(boundary, "one boundary")
    blamed.require(blamed.shapes(learner.noise, given.key), "one number as noise")
    frames = max(learner.least_frames, 2)
    memory = jax.eval_shape(lambda: replay.init(frames, 1, agent.layout))
    size = config.boundary_batch_size

    def draw(memory: replay.Replay, key: jax.Array, gamma: jax.Array) -> BoundaryTransition:
        return learner.draw(memory, agent.layout, jnp.int32(0), key, size, gamma)

    pool = blamed.shapes(draw, memory, given.key, given.number)
    if not isinstance(pool, BoundaryTransition):
        raise blamed.refuse("draw must give a BoundaryTransition")
    blamed.require(pool.reward, f"{size} rewards", (size,))
    pool = dataclasses.replace(pool, indicator=floats(size), next_indicator=floats(size))
    improved = blamed.shapes(learner.improve, hyper, state, pool)
    if not (isinstance(improved, tuple) and len(improved) == 2):
        raise blamed.refuse("improve must give (state, metrics)")
    after, metrics = improved
    blamed.require_same("improve", state, after)
    try:
        require_measured(metrics)
    except (AttributeError, TypeError, ValueError) as error:
        raise blamed.refuse(f"metrics of improve: {error}") from error
    return state
