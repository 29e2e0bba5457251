"""Our walkers behind gymnasium's interfaces, one and many.

    gymnasium.make("hitl_jax.envs.gymnasium_env:hitl_jax/BipedalWalker-v3")
    gymnasium.make_vec("hitl_jax.envs.gymnasium_env:hitl_jax/BipedalWalker-v3", num_envs=64)

The names are registered when this module is imported. The walkers end their own episodes after
gymnasium's 1600 (hardcore 2000) steps.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from hitl_jax.envs import OUR_WALKERS, WALKER, default_backend, make_pool
from hitl_jax.envs.base import Command, StepBatch

_Info = dict[str, Any]
_MOST_SEED = 2**32


def _spaces() -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Of one walker: what it observes, without gymnasium's bounds, and its actions."""
    return (
        gymnasium.spaces.Box(-np.inf, np.inf, (24,), np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (4,), np.float32),
    )


class WalkerVectorEnv(gymnasium.vector.VectorEnv):
    """N walkers of a pool (`make_pool`); in the step after its last one a walker begins anew."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        env_id: str = WALKER,
        backend: str | None = None,
        num_workers: int | None = None,
    ):
        """Makes the walkers.

        Args:
            num_envs: N.
            env_id: which terrain, one of `OUR_WALKERS`.
            backend: `lean` (default), or `jax` (the default where Box2D is missing).
            num_workers: see `make_pool`.
        """
        backend = backend or default_backend(env_id)
        self._pool = make_pool(backend, num_envs, num_workers, env_id)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = _spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: _Info | None = None,
    ) -> tuple[np.ndarray, _Info]:
        """Begins an episode of every walker.

        Args:
            seed: of the first walker, the others have the next ones; or of each.
            options: none are known.

        Returns:
            Observations [N, 24], and nothing.
        """
        given: Sequence[int | None] = ()
        if isinstance(seed, int | np.integer):
            given = range(int(seed), int(seed) + self.num_envs)
        elif seed is not None:
            given = list(seed)
        super().reset(seed=next((int(one) for one in given if one is not None), None))
        seeds = self._drawn()
        for place, one in enumerate(given):
            if one is not None:
                seeds[place] = int(one) % _MOST_SEED
        answer = self._tick(np.full(self.num_envs, Command.RESET), None, seeds)
        return answer.observation, {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, _Info]:
        """A step of every walker; one whose episode has ended begins its next instead.

        Args:
            actions: [N, 4], clipped to [-1, 1].

        Returns:
            Observations [N, 24], rewards [N], whether the task ended [N], whether the time did
            [N], and nothing.
        """
        command = np.where(self._ended, Command.RESET, Command.STEP)
        answer = self._tick(command, actions, self._drawn())
        return *answer, {}

    def _tick(
        self, command: np.ndarray, actions: np.ndarray | None, seeds: np.ndarray
    ) -> StepBatch:
        shape = self.num_envs, self._pool.action_size
        given = np.zeros(shape) if actions is None else np.asarray(actions).reshape(shape)
        answer = self._pool.step(command, given.astype(np.float32), seeds)
        self._ended = answer.terminated | answer.truncated
        return answer

    def _drawn(self) -> np.ndarray:
        return self.np_random.integers(_MOST_SEED, size=self.num_envs, dtype=np.uint32)

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the walkers' processes."""
        self._pool.close()


class WalkerEnv(gymnasium.Env):
    """One walker; for many take `gymnasium.make_vec`."""

    def __init__(self, env_id: str = WALKER, backend: str | None = None):
        """Makes it; see `WalkerVectorEnv`."""
        self._one = WalkerVectorEnv(1, env_id, backend, 1)
        self.observation_space, self.action_space = _spaces()

    def reset(
        self, *, seed: int | None = None, options: _Info | None = None
    ) -> tuple[np.ndarray, _Info]:
        """Begins an episode; equal seeds have equal terrain."""
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(_MOST_SEED))
        return self._one.reset(seed=seed)[0][0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, _Info]:
        """A step of 0.02 s with an action [4]."""
        observation, reward, terminated, truncated, info = self._one.step(np.asarray(action)[None])
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            info,
        )

    def close(self) -> None:
        """Ends the walker's process."""
        self._one.close()


for _env_id in OUR_WALKERS:
    gymnasium.register(
        f"hitl_jax/{_env_id}",
        entry_point=f"{__name__}:WalkerEnv",
        vector_entry_point=f"{__name__}:WalkerVectorEnv",
        kwargs={"env_id": _env_id},
    )
