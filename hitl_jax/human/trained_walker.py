"""Hands that can walk: the actor of a trained walker, which comes with the package."""

import functools

from hitl_jax.human import shipped_network
from hitl_jax.human.actions import ACTION_SOURCES, ActionSource, policy
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.learner.networks import Actor

FILE, PREFIX = "hands.npz", "actor"
"""Where its parameters are; the file is like a run's params.npz."""


@ACTION_SOURCES.register("trained", "a trained walker, which comes with the package")
def _trained(action_size: int) -> ActionSource:
    del action_size
    return trained_walker()


def trained_walker() -> ActionSource:
    """A walker for BipedalWalker-v3 that goes on where others have stumbled."""
    return trained_hands(FILE, WALKER_OBSERVATION)


@functools.cache
def trained_hands(
    file: str, observation_size: int, package: str = "hitl_jax.human"
) -> ActionSource:
    """Hands whose actions a trained actor gives.

    Args:
        file: of an `Actor`, see `shipped_network.load`.
        observation_size: O.
        package: where it is.
    """
    params, (*hidden, action_size) = shipped_network.load(file, PREFIX, package)
    return policy(Actor(tuple(hidden), action_size).apply, params)._replace(
        observation_size=observation_size, action_size=action_size
    )
