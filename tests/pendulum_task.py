"""A task of one's own, as the README has it: `hitl-jax sweep --env pendulum_task:pendulum`."""

import jax.numpy as jnp

from hitl_jax.human.actions import policy
from hitl_jax.human.danger import beyond
from hitl_jax.tasks import Task


def tilt(observation):  # c_t [rad]: 0 is upright.
    return jnp.arctan2(observation[1], observation[0])


def swing(_params, observation):  # a^h, in [-1, 1]: it swings up, and balances near the top.
    angle, speed = tilt(observation), observation[2:]
    too_high = 0.5 * speed**2 + 15.0 * (jnp.cos(angle) - 1.0)  # Energy.
    return jnp.where(jnp.abs(angle) < 0.3, -5.0 * angle - speed, -jnp.sign(too_high * speed))


danger, hand = beyond(tilt), policy(swing, None)
names = {"indicator": "tilt", "danger": "danger", "human_actions": "hand"}
changes = {option: f"pendulum_task:{name}" for option, name in names.items()}
pendulum = Task("Pendulum-v1", changes=changes | {"tolerance": 1.0, "boundary_high": 3.1})
