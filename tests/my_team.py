"""One choice of each kind, as somebody else writes it, and some that are none."""

import jax.numpy as jnp
import numpy as np

from hitl_jax.arbiter import Intervention, Ruling
from hitl_jax.boundary import BoundarySource
from hitl_jax.choices.options import Option
from hitl_jax.envs import Command, StepBatch
from hitl_jax.envs.base import CheckedPool
from hitl_jax.human import memoryless
from hitl_jax.human.indicator import sees


@sees(3)
def tilt(observation):
    """An indicator: the first of three numbers."""
    return observation[0]


def drifting():
    """A boundary source: τ falls by a number of its own at every step."""
    option = Option("drift", 0.001, "what τ loses in a step", "rad", 0.0, 0.1)
    return BoundarySource(
        init=lambda initial: initial,
        boundary=lambda carry, network: carry,
        advance=lambda carry, move: jnp.maximum(carry - move.extra["drift"], move.low),
        options=(option,),
    )


def patient():
    """An intervention: the human acts from the second alarm of an episode on; counts them."""

    def rule(alarms, now):
        agreed = now.alarmed & now.dangerous
        acts = agreed & (alarms >= now.extra["patience"])
        ruling = Ruling(agreed, agreed & (alarms == 0), acts, jnp.zeros((), bool))
        return alarms + jnp.asarray(agreed, jnp.int32), ruling

    return Intervention(lambda: 0, rule, (Option("patience", 1.0, "alarms let by", "1", 0.0),))


def steep():
    """A danger model: the tilt and what it becomes soon."""

    def rule(params, observation, dangerous, key):
        soon = observation[0] + params.extra["ahead"] * observation[1]
        return jnp.abs(soon) >= params.tolerance

    return memoryless(rule, 3, (Option("ahead", 0.5, "how far ahead is seen", "s", 0.0, 9.0),))


def startled():
    """A part of a human: sees danger wherever the pole moves fast, too."""
    return memoryless(lambda params, seen, dangerous, key: dangerous | (jnp.abs(seen[1]) > 0.2))


def hand(action_size):
    """Actions of the human: none."""
    from hitl_jax.human import actions

    return actions.policy(lambda params, seen: jnp.full(action_size, 0.5), None)


class Poles(CheckedPool):
    """An environment: N tilting poles with 3 observations and 1 action."""

    seedable = True

    def __init__(self, num_walkers, **others):
        super().__init__(num_walkers, 3, 1)
        self._state = np.zeros((num_walkers, 3), np.float32)

    def _start(self, command, action, seed):
        for walker in np.flatnonzero(command == Command.RESET):
            rng = np.random.default_rng(int(seed[walker]))
            self._state[walker] = rng.uniform(-0.3, 0.3), 0.0, 0.0
        moving = command == Command.STEP
        tilt, speed, age = self._state[moving].T
        speed = speed + 0.01 * action[moving, 0] + 0.005 * tilt
        self._state[moving] = np.stack([tilt + speed, speed, age + 1], axis=1)

    def _finish(self, command):
        moving = command == Command.STEP
        fell = moving & (np.abs(self._state[:, 0]) > 1.0)
        reward = np.where(moving, 1.0 - np.abs(self._state[:, 0]), 0.0).astype(np.float32)
        return StepBatch(
            observation=self._state.copy(),
            reward=np.where(fell, np.float32(-100.0), reward),
            terminated=fell,
            truncated=moving & (self._state[:, 2] >= 30) & ~fell,
        )

    def _shutdown(self):
        pass


def poles(num_walkers, num_workers, env_id, seed):
    return Poles(num_walkers)


def of_another_kind():
    return 3


def broken():
    raise ValueError("its file\nis missing")


def two_numbers(observation):
    return observation[:2]
