"""EnvPool's walkers, stepped by threads in C++: faster, with Box2D 2.4 and terrain of its own."""

import numpy as np

from hitl_jax.envs.base import Command, StepBatch, WalkerPool
from hitl_jax.episodes import FALL_REWARD


class EnvPoolPool(WalkerPool):
    """N walkers in EnvPool.

    EnvPool resets a walker at the call after its episode's end, ignores that call's action and
    gives reward 0: that call is our RESET of a walker that has ended. Seeds are fixed when the pool
    is made, so `seed` is not honoured and an episode cannot be repeated.
    """

    seedable = False

    def __init__(self, env_id: str, num_walkers: int, num_threads: int, seed: int = 0):
        """Makes the walkers.

        Args:
            env_id: an environment of EnvPool.
            num_walkers: N.
            num_threads: threads of EnvPool.
            seed: of all terrain.

        Raises:
            ImportError: if EnvPool is not installed.
        """
        try:
            import envpool
        except ImportError as error:
            raise ImportError(
                '--backend envpool: needs EnvPool; install it with pip install -e ".[fast]"'
            ) from error
        self._env = envpool.make_gymnasium(
            env_id, num_envs=num_walkers, num_threads=num_threads, seed=seed
        )
        self.num_walkers = num_walkers
        (self.observation_size,) = self._env.observation_space.shape
        (self.action_size,) = self._env.action_space.shape
        self._observation = np.zeros((num_walkers, self.observation_size), np.float32)
        # A walker that was never reset counts as ended: EnvPool then starts it at the first call.
        self._ended = np.ones(num_walkers, bool)

    def step(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> StepBatch:
        """One tick; see `WalkerPool.step`. `seed` is not read."""
        del seed
        reward = np.zeros(self.num_walkers, np.float32)
        terminated = np.zeros(self.num_walkers, bool)
        truncated = np.zeros(self.num_walkers, bool)
        resets = command == Command.RESET
        forced = np.flatnonzero(resets & ~self._ended).astype(np.int32)
        if forced.size:
            observation, info = self._env.reset(forced)
            self._observation[info["env_id"]] = observation
        called = (command == Command.STEP) | (resets & self._ended)
        ids = np.flatnonzero(called).astype(np.int32)
        if ids.size:
            observation, rewards, terminations, truncations, info = self._env.step(
                np.ascontiguousarray(action[ids]), ids
            )
            order = info["env_id"]
            self._observation[order] = observation
            reward[order] = rewards
            terminated[order] = terminations
            truncated[order] = truncations
        # EnvPool reports a fall at the time limit as truncated only.
        terminated |= truncated & (reward <= FALL_REWARD)
        for flags in (reward, terminated, truncated):
            flags[resets] = 0
        self._ended[resets] = False
        self._ended |= terminated | truncated
        return StepBatch(self._observation.copy(), reward, terminated, truncated)

    def close(self) -> None:
        """Ends EnvPool's threads."""
        self._env.close()
