"""`EnvpoolPool`: EnvPool's walkers, the same task in C++, stepped by threads of this process."""

import numpy as np

from hitl_jax.envs.base import CheckedPool, Command, StepBatch
from hitl_jax.errors import Unplayable

_NO_LIMIT = 2**31 - 1


class EnvpoolPool(CheckedPool):
    """N walkers of EnvPool as a `WalkerPool`.

    The numbers are not gymnasium's: EnvPool has Box2D 2.4 (gymnasium has 2.3), and seeds terrain
    once, when the pool is made. So a RESET's seed is not read, and an episode cannot be repeated.

    Two habits of EnvPool are hidden. Its call after a termination resets the walker and ignores the
    action: the pool makes that call at the RESET, beside the others' steps; it resets walkers in
    mid-episode by a separate call. And EnvPool reports a fall in the step that reaches the time
    limit as truncated alone: the pool gives EnvPool no limit and keeps the limit itself, with
    gymnasium's meaning.
    """

    seedable = False

    def __init__(
        self,
        env_id: str,
        num_walkers: int,
        num_threads: int,
        seed: int = 0,
        max_episode_steps: int | None = None,
    ):
        """Makes the walkers.

        Args:
            env_id: EnvPool's name of the environment; it must have flat observations and flat
                continuous actions, onto whose bounds [-1, 1] is scaled.
            num_walkers: N.
            num_threads: number of threads that step them.
            seed: of all episodes; walker i has `seed + i`.
            max_episode_steps: time limit [steps]; the environment's own by default.

        Raises:
            ImportError: if EnvPool is missing.
            ValueError: if EnvPool has no such environment, or it cannot be played.
        """
        try:
            import envpool  # type: ignore[import-not-found, unused-ignore]
        except ImportError as error:
            raise ImportError(
                f"backend 'envpool': {error}; install it with: pip install -e \".[fast]\""
            ) from error
        if env_id not in envpool.list_all_envs():
            raise Unplayable(env_id, "must be one of envpool.list_all_envs()")
        from hitl_jax.envs.spaces import action_map, flat_size

        if max_episode_steps is None:
            max_episode_steps = envpool.make_spec(env_id).config.max_episode_steps
        self._limit = max_episode_steps
        self._envs = envpool.make_gymnasium(
            env_id,
            num_envs=num_walkers,
            num_threads=num_threads,
            seed=seed,
            max_episode_steps=_NO_LIMIT,
        )
        try:
            observation_size = flat_size(env_id, "observation", self._envs.observation_space)
            action_size = flat_size(env_id, "action", self._envs.action_space)
            self._scaled = action_map(env_id, self._envs.action_space)
        except Unplayable:
            self._envs.close()
            raise
        super().__init__(num_walkers, observation_size, action_size)
        self._observation = np.zeros((num_walkers, observation_size), np.float32)
        # The terminated walkers, which EnvPool resets at their next call.
        self._over = np.zeros(num_walkers, bool)
        self._called = False

    def _start(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        again = self._over & (command == Command.RESET)
        called = np.flatnonzero((command == Command.STEP) | again).astype(np.int32)
        self._called = bool(called.size)
        if called.size:
            self._envs.send(self._scaled(action[called]), called)

    def _finish(self, command: np.ndarray) -> StepBatch:
        reward = np.zeros(self.num_walkers, np.float32)
        terminated = np.zeros(self.num_walkers, bool)
        truncated = np.zeros(self.num_walkers, bool)
        resets = command == Command.RESET
        if self._called:
            observation, rewards, ended, _, info = self._envs.recv()
            order = info["env_id"]
            self._observation[order] = observation
            reward[order] = rewards
            terminated[order] = ended
            truncated[order] = info["elapsed_step"] >= self._limit
            reward[resets] = 0.0  # Of a call that resets, these are of no step.
            terminated[resets] = truncated[resets] = False
        # After the others' steps: EnvPool mixes up the answers of two calls at once.
        forced = np.flatnonzero(resets & ~self._over).astype(np.int32)
        if forced.size:
            observation, info = self._envs.reset(forced)
            self._observation[info["env_id"]] = observation
        self._over[resets] = False
        self._over |= terminated
        return StepBatch(self._observation.copy(), reward, terminated, truncated)

    def _shutdown(self) -> None:
        self._envs.close()
