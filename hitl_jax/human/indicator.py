"""The safety indicator c_t: a number in physical units, which the alarm compares with the boundary.

An indicator is any function of one observation f32[O] that gives a scalar f32[]. The named ones
read BipedalWalker-v3, whose observation holds at index 0 the hull's angle [rad] and at index 1 its
angular velocity ω [rad/s] as 2 ω / FPS (gymnasium/envs/box2d/bipedal_walker.py, `step`).
"""

from collections.abc import Callable

import chex

Indicator = Callable[[chex.Array], chex.Array]
"""Maps s_t, f32[O], to c_t, f32[]."""

FPS = 50
"""Steps of the walker per second (gymnasium/envs/box2d/bipedal_walker.py, `FPS`)."""


def hull_angle(observation: chex.Array) -> chex.Array:
    """c_t = the hull's angle against the horizontal [rad]; positive leans back.

    Args:
        observation: s_t, [O].
    """
    chex.assert_rank(observation, 1)
    return observation[0]


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

    def indicator(observation: chex.Array) -> chex.Array:
        angle, velocity = hull_angle(observation), hull_angular_velocity(observation)
        return angle_weight * angle + velocity_weight * velocity

    return indicator


INDICATORS: dict[str, Indicator] = {
    "hull_angle": hull_angle,
    "hull_angular_velocity": hull_angular_velocity,
    "weighted": weighted(),
}


def get_indicator(name_or_function: str | Indicator) -> Indicator:
    """The indicator of that name, or the function itself.

    Args:
        name_or_function: a name in `INDICATORS`, or a function of an observation [O] to c_t [].

    Raises:
        ValueError: one line with the allowed names, for anything else.
    """
    if callable(name_or_function):
        return name_or_function
    if name_or_function not in INDICATORS:
        raise ValueError(
            f"indicator {name_or_function}: must be one of {', '.join(INDICATORS)}, "
            "or a function of the observation"
        )
    return INDICATORS[name_or_function]
