"""LunarLander with continuous engines: to crash, or to leave the field, is to fall."""

import chex

from hitl_jax.human.indicator import INDICATORS, in_unit, sees
from hitl_jax.results.episode_measures import EndRule
from hitl_jax.tasks.shipped_human import register_human
from hitl_jax.tasks.task import TASKS, Task

_OBSERVATION = 8
_TILT = 4
"""Where an observation has the angle of the lander [rad]."""


@INDICATORS.register("lander_tilt", "angle of the lander [rad]")
@sees(_OBSERVATION)
@in_unit("rad")
def lander_tilt(observation: chex.Array) -> chex.Array:
    """c_t = the lander's angle against the upright [rad].

    Args:
        observation: s_t, [8].
    """
    chex.assert_rank(observation, 1)
    return observation[_TILT]


TASKS.register("LunarLanderContinuous-v3", "a lander, tilt in rad")(
    Task(
        "LunarLanderContinuous-v3",
        ends=EndRule(fall_reward=-100.0, goal=True),
        changes=register_human("lunar_lander", _OBSERVATION)
        | {
            "observation_size": _OBSERVATION,
            "action_size": 2,
            "indicator": "lander_tilt",
            "initial_boundary": 0.4,
        },
        solved=200.0,
    )
)
