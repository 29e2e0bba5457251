"""Interventions by name: u_t, and what the human does where it is 1.

To add one, write an `Intervention` and register it.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import chex
import jax.numpy as jnp
from flax import struct

from hitl_jax.choices.options import Option, options_of
from hitl_jax.choices.registry import Registry

State = Any
"""What an intervention remembers within an episode: a pytree of arrays, or of plain numbers."""


class Situation(NamedTuple):
    """What an intervention is decided by, at one step.

    Attributes:
        alarmed: C, bool [].
        dangerous: h_t = 0, and the human is there, bool [].
        keeps: whether a takeover goes on, bool []; see `releases`.
        takeover_steps: least length of a takeover in steps, int32 [].
        extra: the run's numbers of the choices' own, by name, each [].
    """

    alarmed: chex.Array
    dangerous: chex.Array
    keeps: chex.Array
    takeover_steps: chex.Array
    extra: Mapping[str, chex.Array]


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


class Intervention(NamedTuple):
    """What a human intervention does: pure functions for one run.

    Attributes:
        init: () to the state at the start of every episode, in which the machine is in control.
        rule: (state, `Situation`) to (state, `Ruling`); called once a step. u_t = 1 where the alarm
            is raised and the human agrees (line 8).
        options: traced numbers of its own, in `Situation.extra`.
    """

    init: Callable[[], State]
    rule: Callable[[State, Situation], tuple[State, Ruling]]
    options: tuple[Option, ...] = ()


INTERVENTIONS: Registry[Intervention] = Registry(
    "intervention",
    "intervention",
    lambda value: isinstance(value, Intervention),
    require=options_of,
)


@struct.dataclass
class ArbiterState:
    """What the arbiter of one run remembers within an episode.

    Attributes:
        hold: steps for which the human keeps control whatever happens, int32 [].
        in_control: whether the human's action was executed last, bool [].
    """

    hold: chex.Array
    in_control: chex.Array


def _machine_in_control() -> ArbiterState:
    return ArbiterState(hold=jnp.zeros((), jnp.int32), in_control=jnp.zeros((), bool))


@INTERVENTIONS.register("reset", "the human ends the episode")
def reset() -> Intervention:
    """The episode ends after this step ("dangerous and needs to be reset", section IV)."""

    def rule(state: ArbiterState, now: Situation) -> tuple[ArbiterState, Ruling]:
        agreed = jnp.logical_and(now.alarmed, now.dangerous)
        never = jnp.zeros((), bool)
        return state, Ruling(control=agreed, began=agreed, human_action=never, human_reset=agreed)

    return Intervention(_machine_in_control, rule)


@INTERVENTIONS.register("takeover", "the human acts until the state is safe")
def takeover() -> Intervention:
    """The human's action is executed as long as `keeps` holds, at least `takeover_steps` steps.

    That is until the human judges the state safe again or, with hysteresis, until c_t is well
    within the boundary. u_t stays 1.
    """

    def rule(state: ArbiterState, now: Situation) -> tuple[ArbiterState, Ruling]:
        agreed = jnp.logical_and(now.alarmed, now.dangerous)
        never = jnp.zeros((), bool)
        goes_on = jnp.logical_and(state.in_control, jnp.logical_or(state.hold > 0, now.keeps))
        control = jnp.logical_or(agreed, goes_on)
        began = jnp.logical_and(control, jnp.logical_not(state.in_control))
        hold = jnp.where(began, now.takeover_steps, state.hold) - 1
        state = ArbiterState(hold=jnp.maximum(hold, 0), in_control=control)
        return state, Ruling(control=control, began=began, human_action=control, human_reset=never)

    return Intervention(_machine_in_control, rule)


@INTERVENTIONS.register("penalty", "only the reward changes")
def penalty() -> Intervention:
    """The machine keeps acting; the reward of a step with u_t = 1 has the human's feedback."""

    def rule(state: ArbiterState, now: Situation) -> tuple[ArbiterState, Ruling]:
        agreed = jnp.logical_and(now.alarmed, now.dangerous)
        never = jnp.zeros((), bool)
        began = jnp.logical_and(agreed, jnp.logical_not(state.in_control))
        state = ArbiterState(hold=state.hold, in_control=agreed)
        return state, Ruling(control=agreed, began=began, human_action=never, human_reset=never)

    return Intervention(_machine_in_control, rule)
