"""Hands that can walk: the actor of a trained walker, which comes with the package."""

import functools

from hitl_jax.human import shipped_network
from hitl_jax.human.actions import ACTION_SOURCES, ActionSource, policy
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.learner.networks import Actor

FILE, PREFIX = "trained_walker.npz", "actor"
"""Where its parameters are; the file is like a run's params.npz."""


@ACTION_SOURCES.register("trained", "a trained walker, which comes with the package")
def _trained(action_size: int) -> ActionSource:
    del action_size
    return trained_walker()


@functools.cache
def trained_walker() -> ActionSource:
    """A walker for BipedalWalker-v3 that goes on where others have stumbled."""
    params, (*hidden, action_size) = shipped_network.load(FILE, PREFIX)
    return policy(Actor(tuple(hidden), action_size).apply, params)._replace(
        observation_size=WALKER_OBSERVATION, action_size=action_size
    )
