"""Hopper and Walker2d of MuJoCo: to be "unhealthy", their only end in time, is to fall."""

import chex

from hitl_jax.human.indicator import INDICATORS, in_unit
from hitl_jax.tasks.shipped_human import register_human
from hitl_jax.tasks.task import EVERY_END, TASKS, Task

_STEPS_PER_SECOND = 125
_TORSO = 1
"""Where an observation has the torso's angle [rad]."""

_IN_TIME = {"delay": _STEPS_PER_SECOND // 5, "takeover_steps": _STEPS_PER_SECOND}
"""What is 0.2 s and a second with the walker."""


@INDICATORS.register("torso_angle", "of Hopper and Walker2d [rad]")
@in_unit("rad")
def torso_angle(observation: chex.Array) -> chex.Array:
    """c_t = the torso's angle against the upright [rad].

    Args:
        observation: s_t, [11] of Hopper, [17] of Walker2d.
    """
    chex.assert_rank(observation, 1)
    return observation[_TORSO]


TASKS.register("Hopper-v5", "needs the extra `mujoco`; angle of the torso in rad")(
    Task(
        "Hopper-v5",
        EVERY_END,
        _IN_TIME
        | register_human("hopper", 11)
        | {
            "observation_size": 11,
            "action_size": 3,
            "indicator": "torso_angle",
            # A torso at 0.2 rad is unhealthy.
            "initial_boundary": 0.12,
            "boundary_high": 0.3,
            "boundary_noise": 0.02,
        },
        solved=3800.0,
        steps_per_second=_STEPS_PER_SECOND,
    )
)
TASKS.register("Walker2d-v5", "needs the extra `mujoco`; angle of the torso in rad")(
    Task(
        "Walker2d-v5",
        EVERY_END,
        _IN_TIME
        | register_human("walker2d", 17)
        | {
            "observation_size": 17,
            "action_size": 6,
            "indicator": "torso_angle",
            "initial_boundary": 0.5,  # At 1 rad it is unhealthy.
        },
        steps_per_second=_STEPS_PER_SECOND,
    )
)
