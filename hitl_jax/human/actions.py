"""The human's actions a^h of one run by name: where they come from, behind one interface.

To add a source, write an `ActionSource` and register it.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from flax import struct

from hitl_jax.choices.registry import Registry
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.types import Params
from hitl_jax.xla.row_by_row import row_by_row

State = Any
"""What a source remembers: a pytree of arrays, or of plain numbers at first; see
`hitl_jax.human.caller_state`."""


class ActionSource(NamedTuple):
    """A source of actions, asked once a step.

    Attributes:
        init: () to the state at the start of a run.
        begin_episode: state to the state at the start of an episode.
        act: (state, observation [O], key) to (state, action [A] in [-1, 1]); the key is consumed.
        observation_size: of the observations that it was made for; None where any will do.
        action_size: of the actions that it gives, likewise.
    """

    init: Callable[[], State]
    begin_episode: Callable[[State], State]
    act: Callable[[State, chex.Array, chex.PRNGKey], tuple[State, chex.Array]]
    observation_size: int | None = None
    action_size: int | None = None


ACTION_SOURCES: Registry[ActionSource] = Registry(
    "source of actions", "human_actions", lambda value: isinstance(value, ActionSource)
)
"""Each is made from the number of actions."""


def policy(apply: Callable[[Params, chex.Array], chex.Array], params: Params) -> ActionSource:
    """A trained policy, without exploration.

    Args:
        apply: maps (params, observation [O]) to an action [A] in [-1, 1].
        params: its parameters.
    """
    action = row_by_row(apply)

    def act(state: State, observation: chex.Array, key: chex.PRNGKey) -> tuple[State, chex.Array]:
        del key
        return state, action(params, observation)

    return ActionSource(init=tuple, begin_episode=lambda state: state, act=act)


def with_noise(source: ActionSource, scale: chex.Numeric) -> ActionSource:
    """Adds white Gaussian noise to another source's actions and clips them to [-1, 1].

    Args:
        source: the other source.
        scale: standard deviation of the noise, in units of action.
    """

    def act(state: State, observation: chex.Array, key: chex.PRNGKey) -> tuple[State, chex.Array]:
        source_key, noise_key = jax.random.split(key)
        state, action = source.act(state, observation, source_key)
        noise = scale * jax.random.normal(noise_key, action.shape, jnp.float32)
        return state, jnp.clip(action + noise, -1.0, 1.0)

    return source._replace(act=act)


@ACTION_SOURCES.register("still", "no torque, whatever is seen")
def still(action_size: int) -> ActionSource:
    """Actions of 0.

    Args:
        action_size: A.
    """
    return policy(lambda params, observation: jnp.zeros((action_size,), jnp.float32), None)


@ACTION_SOURCES.register("scripted", "gymnasium's scripted walker")
def _scripted(action_size: int) -> ActionSource:
    del action_size
    return scripted_walker()


# The scripted walker: a state machine of three phases, the numbers those of gymnasium 1.4,
# gymnasium/envs/box2d/bipedal_walker.py, class BipedalWalkerHeuristics.

STAY_ON_ONE_LEG, PUT_OTHER_DOWN, PUSH_OFF = 1, 2, 3
_SPEED = 0.29  # Forward speed that it keeps to, as in the observation: faster, it falls.
_SUPPORT_KNEE = 0.1  # The straightest that the knee of the supporting leg becomes.
_STRAIGHTEN = 0.03  # By how much it is straightened in a step; twice that above _SPEED.
_SWING_HIP, _SWING_KNEE = 1.1, -0.6  # Targets of the moving leg while it swings forward ...
_LANDING_HIP = 0.1  # ... and while it is put down.
_BEHIND = 0.1  # Below this hip angle the supporting leg is behind, and the other is put down.
_PUSH_KNEE = 1.0  # Target of the supporting leg's knee as it pushes off ...
_PUSHED_KNEE, _PUSHED_SPEED = 0.88, 1.2 * _SPEED  # ... until it is this straight, or this fast.
_HIP_GAIN, _KNEE_GAIN, _DAMPING = 0.9, 4.0, 0.25
_HULL_GAIN, _HULL_DAMPING = 0.9, 1.5  # Hips, to keep the hull level.
_HEAVE_DAMPING = 15.0  # Knees, against vertical speed.

_ACTION_SIZE = 4
_LEGS = slice(4, 14)  # Of the observation: two legs of five entries each, in this order:
_HIP, _HIP_SPEED, _KNEE, _KNEE_SPEED, _CONTACT = range(5)


@struct.dataclass
class WalkerState:
    """What the scripted walker remembers within an episode.

    Attributes:
        phase: STAY_ON_ONE_LEG, PUT_OTHER_DOWN or PUSH_OFF, int32 [].
        swapped: whether leg 1 is the moving leg and leg 0 the supporting one, bool [].
        support_knee: target of the supporting knee, f32 [].
    """

    phase: chex.Array
    swapped: chex.Array
    support_knee: chex.Array


@functools.cache
def scripted_walker() -> ActionSource:
    """Gymnasium's scripted walker, as a pure function: slow, and a fair human for BipedalWalker-v3.

    It stays on one leg while the other swings forward, puts that down, pushes off with the first,
    and changes legs. Proportional-derivative control follows the targets of a phase. Asked for an
    action, it raises ValueError, at trace time, where observations are not that walker's.
    """

    def init() -> WalkerState:
        return WalkerState(
            phase=jnp.array(STAY_ON_ONE_LEG, jnp.int32),
            swapped=jnp.zeros((), bool),
            support_knee=jnp.array(_SUPPORT_KNEE, jnp.float32),
        )

    def act(
        state: WalkerState, observation: chex.Array, key: chex.PRNGKey
    ) -> tuple[WalkerState, chex.Array]:
        del key
        if observation.shape != (WALKER_OBSERVATION,):
            raise ValueError(
                f"observation of shape {observation.shape}: the scripted walker sees "
                f"{WALKER_OBSERVATION}; give `make_agent` another source"
            )
        legs = _swap(state.swapped, observation[_LEGS].reshape(2, 5))
        after, hip_targets, knee_targets = _advance(state, observation[2], *legs)
        hips = _servo(hip_targets, legs[:, _HIP], legs[:, _HIP_SPEED], _HIP_GAIN)
        knees = _servo(knee_targets, legs[:, _KNEE], legs[:, _KNEE_SPEED], _KNEE_GAIN)
        hull_angle, hull_velocity, heave = observation[0], observation[1], observation[3]
        hips = hips - (_HULL_GAIN * -hull_angle - _HULL_DAMPING * hull_velocity)
        knees = knees - _HEAVE_DAMPING * heave
        action = _swap(state.swapped, jnp.stack([hips, knees], axis=1)).reshape(4)
        return after, jnp.clip(0.5 * action, -1.0, 1.0)

    return ActionSource(init, lambda state: init(), act, WALKER_OBSERVATION, _ACTION_SIZE)


def _advance(
    state: WalkerState, forward_speed: chex.Array, moving: chex.Array, supporting: chex.Array
) -> tuple[WalkerState, chex.Array, chex.Array]:
    """One step of the state machine, which may run through several phases.

    Args:
        state: before the step.
        forward_speed: of the hull, as in the observation, [].
        moving: entries of the moving leg, [5].
        supporting: entries of the supporting leg, [5].

    Returns:
        The next state, and the targets of hips [2] and knees [2], moving leg first.
    """
    stays = state.phase == STAY_ON_ONE_LEG
    faster = jnp.where(forward_speed > _SPEED, jnp.float32(_STRAIGHTEN), 0.0)
    straightened = jnp.minimum(state.support_knee + _STRAIGHTEN + faster, _SUPPORT_KNEE)
    support_knee = jnp.where(stays, straightened, state.support_knee)

    puts_down = (state.phase == PUT_OTHER_DOWN) | (stays & (supporting[_HIP] < _BEHIND))
    landed = puts_down & (moving[_CONTACT] != 0.0)
    landed_knee = jnp.minimum(moving[_KNEE], _SUPPORT_KNEE)

    pushes = (state.phase == PUSH_OFF) | landed
    pushed_knee = jnp.where(landed, landed_knee, support_knee)
    fast = forward_speed > _PUSHED_SPEED
    changes_legs = pushes & ((supporting[_KNEE] > _PUSHED_KNEE) | fast)

    # Where a step runs through several phases, the last one's targets hold.
    hip_target = jnp.where(puts_down, _LANDING_HIP, jnp.where(stays, jnp.float32(_SWING_HIP), 0.0))
    moving_knee = jnp.where(puts_down, jnp.float32(_SUPPORT_KNEE), _SWING_KNEE)
    moving_knee = jnp.where(pushes, pushed_knee, moving_knee)
    supporting_knee = jnp.where(pushes, _PUSH_KNEE, support_knee)

    phase = jnp.where(puts_down, PUT_OTHER_DOWN, STAY_ON_ONE_LEG)
    phase = jnp.where(pushes, PUSH_OFF, phase)
    after = WalkerState(
        phase=jnp.where(changes_legs, STAY_ON_ONE_LEG, phase).astype(jnp.int32),
        swapped=state.swapped ^ changes_legs,
        support_knee=pushed_knee,
    )
    hip_targets = jnp.stack([hip_target, jnp.zeros_like(hip_target)])
    return after, hip_targets, jnp.stack([moving_knee, supporting_knee])


def _servo(target: chex.Array, angle: chex.Array, speed: chex.Array, gain: float) -> chex.Array:
    """Proportional-derivative control; a target of exactly 0 is no target, as in gymnasium."""
    return jnp.where(target != 0.0, gain * (target - angle) - _DAMPING * speed, 0.0)


def _swap(swapped: chex.Array, legs: chex.Array) -> chex.Array:
    """From (leg 0, leg 1) to (moving leg, supporting leg) or back; the legs' axis comes first."""
    return jnp.where(swapped, legs[::-1], legs)
