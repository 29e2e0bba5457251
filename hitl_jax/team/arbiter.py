"""Who is in control: u_t, what an intervention does, and the reward of equation (7)."""

from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct


@struct.dataclass
class ArbiterState:
    """What the arbiter of one run remembers within an episode.

    Attributes:
        hold: steps for which the human keeps control whatever happens, int32 [].
        in_control: whether the human's action was executed last, bool [].
    """

    hold: chex.Array
    in_control: chex.Array


@struct.dataclass
class Ruling:
    """The arbiter's answer at one step.

    Attributes:
        control: u_t, bool [].
        began: whether an intervention began at this step, bool [].
        human_action: whether a^h is executed in place of a, bool [].
        human_reset: whether the human ends the episode after this step, bool [].
    """

    control: chex.Array
    began: chex.Array
    human_action: chex.Array
    human_reset: chex.Array


def init() -> ArbiterState:
    """The state at the start of every episode: the machine is in control."""
    return ArbiterState(hold=jnp.zeros((), jnp.int32), in_control=jnp.zeros((), bool))


def rule(
    state: ArbiterState,
    intervention: str,
    alarmed: chex.Array,
    dangerous: chex.Array,
    keeps: chex.Array,
    takeover_steps: chex.Array,
) -> tuple[ArbiterState, Ruling]:
    """u_t = 1 where the alarm is raised and the human agrees (line 8), and what follows from it.

    `reset`: the human ends the episode after this step ("dangerous and needs to be reset", section
    IV). `takeover`: the human's action is executed as long as `keeps` holds, which is until the
    human judges the state safe again or, with hysteresis, until c_t is well within the boundary, at
    least `takeover_steps` steps; u_t stays 1. `penalty`: only the reward changes.

    Args:
        state: the arbiter's memory.
        intervention: `reset`, `takeover` or `penalty`.
        alarmed: C, bool [].
        dangerous: h_t = 0, bool [].
        keeps: whether a takeover goes on, bool [].
        takeover_steps: least length of a takeover in steps, int32 [].

    Returns:
        The next state and the ruling.

    Raises:
        ValueError: for any other intervention.
    """
    agreed = jnp.logical_and(alarmed, dangerous)
    never = jnp.zeros((), bool)
    if intervention == "reset":
        return state, Ruling(control=agreed, began=agreed, human_action=never, human_reset=agreed)
    if intervention == "penalty":
        began = jnp.logical_and(agreed, jnp.logical_not(state.in_control))
        state = ArbiterState(hold=state.hold, in_control=agreed)
        return state, Ruling(control=agreed, began=began, human_action=never, human_reset=never)
    if intervention == "takeover":
        goes_on = jnp.logical_and(state.in_control, jnp.logical_or(state.hold > 0, keeps))
        control = jnp.logical_or(agreed, goes_on)
        began = jnp.logical_and(control, jnp.logical_not(state.in_control))
        hold = jnp.where(began, takeover_steps, state.hold) - 1
        state = ArbiterState(hold=jnp.maximum(hold, 0), in_control=control)
        return state, Ruling(control=control, began=began, human_action=control, human_reset=never)
    raise ValueError(f"intervention {intervention}: must be one of reset, takeover, penalty")


def shaped_reward(
    reward: chex.Array,
    control: chex.Array,
    feedback: chex.Array,
    schedule: str,
    ended: chex.Array,
    intervened: chex.Array,
) -> chex.Array:
    """r(s, a, u) = r(s, a) + u · r(s, a^h), equation (7).

    The feedback "can be given at each time step, or after each episode" (section III): by `step` it
    comes with every u_t = 1, by `episode` once, with the last reward of an episode in which the
    human intervened. Host (NumPy) and device arrays both serve.

    Args:
        reward: r(s, a), [...].
        control: u_t, bool [...].
        feedback: r(s, a^h), negative for a punishment, [...].
        schedule: `step` or `episode`.
        ended: whether this step ended the episode, bool [...].
        intervened: whether u was 1 at any step of the episode so far, this one included, bool
            [...].

    Returns:
        The reward that is learned from, [...].
    """
    given = control if schedule == "step" else ended & intervened
    where: Any = jnp.where if isinstance(reward, jax.Array) else np.where
    return reward + where(given, feedback, -0.0)  # To which -0 is added keeps its sign, if it is 0.
