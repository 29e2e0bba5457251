"""The reward of equation (7), and when the human's feedback is given, by name."""

from collections.abc import Callable
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.choices.registry import Registry

Schedule = Callable[[chex.Array, chex.Array, chex.Array, chex.Array], chex.Array]
"""Maps u_t, whether an intervention began at the step, whether the step ended the episode, and
whether u was 1 at any of its steps so far, to where r(s, a^h) is given: bool [...] each, of NumPy
or JAX."""

FEEDBACK_SCHEDULES: Registry[Schedule] = Registry(
    "feedback schedule", "feedback_schedule", callable
)


@FEEDBACK_SCHEDULES.register("step", "at every step of an intervention")
def every_step(
    control: chex.Array, began: chex.Array, ended: chex.Array, intervened: chex.Array
) -> chex.Array:
    """With every u_t = 1."""
    del began, ended, intervened
    return control


@FEEDBACK_SCHEDULES.register("onset", "once, at the first step of each intervention")
def once_an_intervention(
    control: chex.Array, began: chex.Array, ended: chex.Array, intervened: chex.Array
) -> chex.Array:
    """With the first u_t = 1 of an intervention.

    As RLIF (https://arxiv.org/abs/2311.12996): that the human had to come is punished, what the
    human then does is not.
    """
    del control, ended, intervened
    return began


@FEEDBACK_SCHEDULES.register("episode", "once, at the end of an episode with an intervention")
def once_an_episode(
    control: chex.Array, began: chex.Array, ended: chex.Array, intervened: chex.Array
) -> chex.Array:
    """With the last reward of an episode in which the human intervened."""
    del control, began
    return ended & intervened


def shaped_reward(
    reward: chex.Array,
    control: chex.Array,
    feedback: chex.Array,
    schedule: str,
    began: chex.Array,
    ended: chex.Array,
    intervened: chex.Array,
    weight: chex.Numeric = 1.0,
) -> chex.Array:
    """r(s, a, u) = w · r(s, a) + u · r(s, a^h); equation (7) where w is 1.

    The feedback "can be given at each time step, or after each episode" (section III). Host (NumPy)
    and device arrays both serve.

    Args:
        reward: r(s, a), [...].
        control: u_t, bool [...].
        feedback: r(s, a^h), negative for a punishment, [...].
        schedule: a name in `FEEDBACK_SCHEDULES`, or `module:name`.
        began: whether an intervention began at this step, bool [...].
        ended: whether this step ended the episode, bool [...].
        intervened: whether u was 1 at any step of the episode so far, this one included, bool
            [...].
        weight: w, [...].

    Returns:
        The reward that is learned from, [...].
    """
    given = FEEDBACK_SCHEDULES.make(schedule)(control, began, ended, intervened)
    where: Any = jnp.where if isinstance(reward, jax.Array) else np.where
    # What -0 is added to keeps its sign, if it is 0.
    return weight * reward + where(given, feedback, -0.0)
