"""Who is in control: what an intervention does, what ends it, and the reward of equation (7)."""

from hitl_jax.arbiter.feedback import FEEDBACK_SCHEDULES, shaped_reward
from hitl_jax.arbiter.interventions import (
    INTERVENTIONS,
    ArbiterState,
    Intervention,
    Ruling,
    Situation,
)
from hitl_jax.arbiter.releases import RELEASES, Takeover

__all__ = [
    "FEEDBACK_SCHEDULES",
    "INTERVENTIONS",
    "RELEASES",
    "ArbiterState",
    "Intervention",
    "Ruling",
    "Situation",
    "Takeover",
    "shaped_reward",
]
