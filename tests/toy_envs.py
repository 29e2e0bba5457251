"""Toy environments, which worker processes import by `toy_envs:Toy-v0`, and pools of them."""

import os
import signal
import sys
import warnings

import gymnasium
import numpy as np

from hitl_jax.envs import Command, StepBatch

IDLE, STEP, RESET = Command.IDLE, Command.STEP, Command.RESET
TOY = "toy_envs:Toy-v0"
GOAL = 5  # step at which the toy terminates
RAISE, DIE = 7.0, 8.0  # actions that break the toy

gymnasium.register("Toy-v0", "toy_envs:Toy", max_episode_steps=GOAL)
gymnasium.register("ShortToy-v0", "toy_envs:Toy", max_episode_steps=3)
gymnasium.register("DiscreteToy-v0", "toy_envs:DiscreteToy")
gymnasium.register(
    "ShortWalker-v0", "gymnasium.envs.box2d.bipedal_walker:BipedalWalker", max_episode_steps=12
)


class Toy(gymnasium.Env):
    """Counts its steps: observation (seed, steps, action[0])."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self):
        assert "jax" not in sys.modules  # A worker would spend a second and 200 MB on it.
        print("said on stdout, which nobody should see")

    def reset(self, *, seed=None, options=None):
        self.seed, self.steps = seed, 0
        return self.observe(0.0), {}

    def step(self, action):
        if action[0] == RAISE:
            raise ArithmeticError("the toy broke")
        if action[0] == DIE:
            os.kill(os.getpid(), signal.SIGKILL)
        self.steps += 1
        return self.observe(action[0]), float(action[1]), self.steps == GOAL, False, {}

    def observe(self, action):
        return np.array([self.seed, self.steps, action], np.float32)


class DiscreteToy(Toy):
    action_space = gymnasium.spaces.Discrete(2)


def make_plain(env_id: str, **options) -> gymnasium.Env:
    """A plain environment; Box2D's import gives a warning which, made an error, ends Python."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gymnasium.make(env_id, **options)


def tick(pool, command, action=0.0, seed=0) -> StepBatch:
    """One tick, with scalars for all walkers allowed."""
    num = pool.num_walkers
    return pool.step(
        np.broadcast_to(command, num),
        np.broadcast_to(action, (num, pool.action_size)),
        np.broadcast_to(seed, num),
    )


def same(left: StepBatch, right: StepBatch) -> None:
    for name, a, b in zip(StepBatch._fields, left, right, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)
