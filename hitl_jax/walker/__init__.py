"""BipedalWalker-v3 in JAX: pure functions that agree with Box2D step by step, on any device."""

from hitl_jax.walker.env import (
    ACTION_SIZE,
    OBSERVATION_SIZE,
    Step,
    Walker,
    made,
    made_on,
    reset,
    step,
)

__all__ = ["ACTION_SIZE", "OBSERVATION_SIZE", "Step", "Walker", "made", "made_on", "reset", "step"]
