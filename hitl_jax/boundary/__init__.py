"""Algorithm 1: the alarm, the Δ rule, and the actor-critic that learns the boundary."""

from hitl_jax.boundary.delta_rule import alarm, boundary_reward, next_boundary
from hitl_jax.boundary.learner import BoundaryLearner
from hitl_jax.boundary.learners import BOUNDARY_LEARNERS
from hitl_jax.boundary.losses import boundary_actor_loss, boundary_critic_loss
from hitl_jax.boundary.sources import SOURCES, BoundarySource, Move

__all__ = [
    "BOUNDARY_LEARNERS",
    "SOURCES",
    "BoundaryLearner",
    "BoundarySource",
    "Move",
    "alarm",
    "boundary_actor_loss",
    "boundary_critic_loss",
    "boundary_reward",
    "next_boundary",
]
