"""Backend `gymnasium`: gymnasium's own environments, stepped one after the other in a worker."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import NormalizeObservation, NormalizeReward

from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SharedArrays
from hitl_jax.envs.spaces import action_map, flat_size
from hitl_jax.errors import Unplayable

_TRIAL_STEPS = 20
_TOLERANCE = 0.01
"""Most that earlier episodes may change the first observation and reward: by 0.0004 in Box2D's
walkers; running statistics change them by 0.5 to 50."""


class OfficialWalkers:
    """The environments of one process: any with flat observations and actions (`worker.Walkers`).

    Each episode is played in a new environment, since a used one is not as new after its `reset`:
    Box2D solves contacts in an order that depends on what its world held before.

    Attributes:
        observation_size: O.
        action_size: A.
    """

    def __init__(self, env_id: str, num_walkers: int):
        """Checks the environment by a few steps; each walker waits for its first RESET.

        Args:
            env_id: gymnasium's name of the environment.
            num_walkers: of this process.

        Raises:
            Unplayable: if there is no such environment, its spaces are of another kind, or its
                episodes do not follow from their seeds and actions.
        """
        self._env_id = env_id
        env = _make(env_id)
        self.observation_size = flat_size(env_id, "observation", env.observation_space)
        self.action_size = flat_size(env_id, "action", env.action_space)
        self._scaled = action_map(env_id, env.action_space)
        self._require_repeatable(env)
        self._envs: list[gymnasium.Env | None] = [None] * num_walkers

    def tick(self, arrays: SharedArrays) -> None:
        """Does each walker's command; the pool has set reward and flags to 0."""
        _, observation, seed, reward, command, terminated, truncated = arrays
        action = self._scaled(arrays.action)
        for index, what in enumerate(command.tolist()):
            env = self._envs[index]
            if what == Command.RESET:
                if env is not None:
                    env.close()
                env = self._envs[index] = _make(self._env_id)
                observation[index], _ = env.reset(seed=int(seed[index]))
            elif what == Command.STEP:
                assert env is not None
                observation[index], gain, terminated[index], truncated[index], _ = env.step(
                    action[index]
                )
                reward[index] = np.asarray(gain).item()  # Some rewards are arrays of one number.

    def _require_repeatable(self, env: gymnasium.Env) -> None:
        """Raises Unplayable if an episode is found to depend on more than seed and actions."""
        if name := _running_wrapper(env):
            raise self._carries_over(name)
        first = self._trial(env, 0)
        env.close()
        env = _make(self._env_id)
        if not np.array_equal(first, self._trial(env, 0), equal_nan=True):
            raise Unplayable(
                self._env_id,
                "two new environments play the same seed and actions differently (unseeded random "
                "numbers, a clock, what they share?): an episode must follow from them",
            )
        self._trial(env, 1)
        later = self._trial(env, 0)
        env.close()
        # Later steps are not compared: with contacts in another order a foot may land later.
        one, other = (np.append(rows[0], rows[1, self.observation_size]) for rows in (first, later))
        if not np.allclose(one, other, rtol=_TOLERANCE, atol=_TOLERANCE, equal_nan=True):
            raise self._carries_over("an episode")

    def _carries_over(self, what: str) -> Unplayable:
        """The error for an environment whose episodes depend on earlier ones."""
        return Unplayable(
            self._env_id,
            f"{what} takes something over from the episodes before (running statistics?): "
            "each must follow from its seed and actions, so it is played in a new environment, "
            "where that would be lost",
        )

    def _trial(self, env: gymnasium.Env, seed: int) -> np.ndarray:
        """Plays the beginning of an episode; rows of `_row`, float64 [steps, O + 3]."""
        rng = np.random.default_rng(0)
        observation, _ = env.reset(seed=seed)
        rows = [self._row(observation, 0.0, False, False)]
        while len(rows) <= _TRIAL_STEPS and not rows[-1][-2:].any():
            action = rng.uniform(-1, 1, self.action_size).astype(np.float32)
            rows.append(self._row(*env.step(self._scaled(action))[:4]))
        return np.array(rows)

    def _row(self, observation: Any, reward: Any, terminated: bool, truncated: bool) -> np.ndarray:
        """Observation, reward and flags as one array [O + 3]; checks the observation's shape."""
        if np.shape(observation) != (self.observation_size,):
            expected = f"its space says {(self.observation_size,)}"
            raise Unplayable(
                self._env_id, f"an observation has shape {np.shape(observation)}: {expected}"
            )
        return np.array(
            [*observation, np.asarray(reward).item(), terminated, truncated], np.float64
        )


def _make(env_id: str) -> gymnasium.Env:
    """Makes a new environment.

    Raises:
        Unplayable: if gymnasium does not know it, or a module is missing.
    """
    try:
        return gymnasium.make(env_id, disable_env_checker=True)
    except ModuleNotFoundError as error:
        raise Unplayable(env_id, str(error)) from error
    except gymnasium.error.Error as error:
        module, _, name = env_id.rpartition(":")
        hint = f"If a module of yours registers it, name that too, 'module:{name}': "
        hint += "walkers are played in processes of their own, which import it"
        if module:
            hint = f"Module {module!r} does not register it"
        known = name in gymnasium.registry
        raise Unplayable(env_id, str(error) if known else f"{error} {hint}") from error


def _running_wrapper(env: gymnasium.Env) -> str | None:
    """Name of the environment's first wrapper with running statistics, if it has one."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, NormalizeObservation | NormalizeReward) and env.update_running_mean:
            return type(env).__name__
        env = env.env
    return None
