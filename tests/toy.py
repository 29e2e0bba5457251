"""A toy plant behind the interface of a walker pool: quick, deterministic, without Box2D."""

import numpy as np

from hitl_jax.envs import Command, StepBatch
from hitl_jax.results.episode_measures import WALKER_ENDS

TIME_LIMIT = 40


class ToyPool:
    """N tilting poles that look like walkers: 24 observations, 4 actions.

    The hull angle drifts with the first action and noise-free dynamics from a seeded start; beyond
    1 rad the walker falls (-100), at the time limit the episode is truncated.
    """

    seedable = True
    ends = WALKER_ENDS
    observation_size = 24
    action_size = 4

    def __init__(self, num_walkers: int):
        self.num_walkers = num_walkers
        self._angle = np.zeros(num_walkers)
        self._speed = np.zeros(num_walkers)
        self._age = np.zeros(num_walkers, int)
        self.steps = 0

    def step(self, command, action, seed):
        for walker in np.flatnonzero(command == Command.RESET):
            rng = np.random.default_rng(int(seed[walker]))
            self._angle[walker], self._speed[walker] = rng.uniform(-0.3, 0.3), rng.normal(0, 0.02)
            self._age[walker] = 0
        moving = command == Command.STEP
        self.steps += int(moving.sum())
        self._speed[moving] += 0.01 * action[moving, 0] + 0.02 * self._angle[moving]
        self._angle[moving] += self._speed[moving]
        self._age[moving] += 1
        fell = moving & (np.abs(self._angle) > 1.0)
        reward = np.where(moving, 1.0 - np.abs(self._angle), 0.0)
        return StepBatch(
            observation=self._observe(),
            reward=np.where(fell, -100.0, reward).astype(np.float32),
            terminated=fell,
            truncated=moving & (self._age >= TIME_LIMIT) & ~fell,
        )

    def close(self):
        pass

    def _observe(self):
        observation = np.zeros((self.num_walkers, 24), np.float32)
        observation[:, 0], observation[:, 1] = self._angle, self._speed * 2
        return observation
