"""Safety indicators c_t by name: a number in physical units, which the alarm compares with τ_t.

To add one, write a function and register it. An indicator is any function of one observation f32[O]
that gives a scalar f32[], or, under `sees_risk`, of an observation and its risk f32[]. The named
ones but `fall_risk` read BipedalWalker-v3, whose observation holds at index 0 the hull's angle
[rad] and at index 1 its angular velocity ω [rad/s] as 2 ω / FPS
(gymnasium/envs/box2d/bipedal_walker.py, `step`).
"""

from collections.abc import Callable
from typing import Any

import chex

from hitl_jax.choices.registry import Registry

WALKER_OBSERVATION = 24
"""Length of BipedalWalker-v3's observation."""

Indicator = Callable[..., chex.Array]
"""Maps s_t, f32[O], to c_t, f32[]; under `sees_risk` s_t and its risk, f32[]."""

FPS = 50
"""Steps of the walker per second (gymnasium/envs/box2d/bipedal_walker.py, `FPS`)."""

INDICATORS: Registry[Indicator] = Registry("safety indicator", "indicator", callable)


def sees(observation_size: int) -> Callable[[Any], Any]:
    """A decorator that says of which observations a function is made; others are refused.

    Args:
        observation_size: O.
    """

    def declare(function: Any) -> Any:
        function.observation_size = observation_size
        return function

    return declare


def in_unit(unit: str) -> Callable[[Any], Any]:
    """A decorator that says what an indicator, and so the boundary, is measured in.

    Args:
        unit: for example `rad`; `1` where it has none.
    """

    def declare(function: Any) -> Any:
        function.unit = unit
        return function

    return declare


def unit_of(name: str) -> str:
    """What a registered indicator is measured in; nothing is known of others."""
    return getattr(INDICATORS.make(name), "unit", "") if name in INDICATORS else ""


def sees_risk(function: Any) -> Any:
    """A decorator that says that an indicator is also given the risk of the observation.

    The risk is the probability that the walker falls within the risk critic's horizon (`risk`),
    which is learned in teams with such an indicator.
    """
    function.sees_risk = True
    return function


def does_see_risk(indicator: Indicator) -> bool:
    """Whether an indicator is to be given the risk."""
    return getattr(indicator, "sees_risk", False)


@INDICATORS.register("hull_angle", "angle of the hull [rad]")
@sees(WALKER_OBSERVATION)
@in_unit("rad")
def hull_angle(observation: chex.Array) -> chex.Array:
    """c_t = the hull's angle against the horizontal [rad]; positive leans back.

    Args:
        observation: s_t, [O].
    """
    chex.assert_rank(observation, 1)
    return observation[0]


@INDICATORS.register("hull_angular_velocity", "its angular velocity [rad/s]")
@sees(WALKER_OBSERVATION)
@in_unit("rad/s")
def hull_angular_velocity(observation: chex.Array) -> chex.Array:
    """c_t = the hull's angular velocity [rad/s], FPS / 2 = 25 times what the observation holds.

    Args:
        observation: s_t, [O].
    """
    chex.assert_rank(observation, 1)
    return 0.5 * FPS * observation[1]


def weighted(angle_weight: chex.Numeric = 1.0, velocity_weight: chex.Numeric = 0.1) -> Indicator:
    """c_t = angle_weight · angle + velocity_weight · angular velocity [rad].

    With an angle weight of 1 it is the angle that the hull will have after `velocity_weight`
    seconds if it goes on turning as it does.

    Args:
        angle_weight: without unit.
        velocity_weight: [s].

    Returns:
        The indicator.
    """

    @sees(WALKER_OBSERVATION)
    @in_unit("rad")
    def indicator(observation: chex.Array) -> chex.Array:
        angle, velocity = hull_angle(observation), hull_angular_velocity(observation)
        return angle_weight * angle + velocity_weight * velocity

    return indicator


INDICATORS.register("weighted", "angle in 0.1 s if the hull goes on turning as it does [rad]")(
    weighted()
)


@INDICATORS.register("fall_risk", "learned probability of a fall within `risk_horizon` [1]")
@sees_risk
@in_unit("1")
def fall_risk(observation: chex.Array, risk: chex.Array) -> chex.Array:
    """c_t = the risk.

    Args:
        observation: s_t, [O]; not looked at.
        risk: of s_t, [].
    """
    del observation
    return risk
