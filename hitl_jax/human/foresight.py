"""A danger model that sees a stumble before the hull tilts: the extrapolated centre of mass.

A person who knows walking sees whether the next foot can still catch the body. Hof, Gazendam and
Sinke ("The condition for dynamic stability", Journal of Biomechanics 38, 2005) put it in a number:
the centre of mass, extrapolated by its velocity v to x + v / ω_0 with ω_0 = √(g / l), against the
foot. A walker that runs is always ahead of its feet; it stumbles where it is too far ahead.

It looks at one observation of BipedalWalker-v3, and at nothing that a learner knows.
"""

import chex
import jax.numpy as jnp

from hitl_jax.choices.options import Option
from hitl_jax.human.danger import DANGER_MODELS
from hitl_jax.human.indicator import FPS, WALKER_OBSERVATION
from hitl_jax.human.params import HumanParams
from hitl_jax.human.part import HumanPart, memoryless

# gymnasium/envs/box2d/bipedal_walker.py, in metres: LEG_H, LEG_DOWN, and VIEWPORT_W / SCALE, by
# which velocities in the observation are scaled.
_LEG, _HIP_DOWN, _VIEW = 34 / 30, 8 / 30, 600 / 30
_SPEED = FPS / (0.3 * _VIEW)
_GRAVITY = 10.0
_LEAST_HEIGHT = 0.2
"""Of the hull over the lower foot [m]: a pendulum shorter than that is none."""

_HIPS, _KNEES = slice(4, 10, 5), slice(6, 12, 5)
_HIP_ZERO = 0.05  # The legs are made with so much angle, forward and back [rad] ...
_KNEE_OFFSET = 1.0  # ... and the observation holds a knee's angle plus 1.

MARGIN = "foresight_margin"
"""Name of the option, in `HumanParams.extra`."""


def feet(observation: chex.Array) -> tuple[chex.Array, chex.Array]:
    """Where the feet are against the hull, forward and up [m], [2] each.

    Args:
        observation: s_t, [24].
    """
    chex.assert_shape(observation, (WALKER_OBSERVATION,))
    hull = observation[0]
    thigh = hull + observation[_HIPS] + jnp.array([-_HIP_ZERO, _HIP_ZERO], jnp.float32)
    shin = thigh + observation[_KNEES] - _KNEE_OFFSET
    forward = _HIP_DOWN * jnp.sin(hull) + _LEG * (jnp.sin(thigh) + jnp.sin(shin))
    up = -_HIP_DOWN * jnp.cos(hull) - _LEG * (jnp.cos(thigh) + jnp.cos(shin))
    return forward, up


def overreach(observation: chex.Array) -> chex.Array:
    """How far the extrapolated centre of mass is ahead of the front foot [m], [].

    The hull stands for the whole body, and the pendulum is as long as it is high over its lower
    foot.

    Args:
        observation: s_t, [24].
    """
    forward, up = feet(observation)
    height = jnp.maximum(-jnp.min(up), _LEAST_HEIGHT)
    extrapolated = _SPEED * observation[2] * jnp.sqrt(height / _GRAVITY)
    return extrapolated - jnp.max(forward)


@DANGER_MODELS.register(
    "foresight",
    "the extrapolated centre of mass is far ahead of the feet, or |hull angle| ≥ tolerance",
)
def foresight() -> HumanPart:
    """Danger is an overreach of at least `foresight_margin`, or a hull as tilted as `tolerance`.

    Whatever was judged before. Who sees a stumble coming also sees a fall.
    """

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del dangerous, key
        tilted = jnp.abs(observation[0]) >= params.tolerance
        return tilted | (overreach(observation) >= params.extra[MARGIN])

    # 3 m, by the overreach alone: of walkers of six tuning seeds (102, 105 to 109; 180 falls), 57 %
    # of the states so judged are within a second of a fall, 1 % of the others are so judged, and
    # danger is seen 0.8 s before a fall by the mean.
    margin = Option(MARGIN, 3.0, "overreach from which a state is dangerous", "m", 0.0)
    return memoryless(rule, WALKER_OBSERVATION, (margin,))
