"""Gymnasium's own environments, several in one process, stepped one after the other."""

from typing import Any

import gymnasium

from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SharedArrays


class OfficialWalkers:
    """The walkers of one process, any environment of flat observations and actions.

    Attributes:
        observation_size: O.
        action_size: A.
    """

    def __init__(self, env_id: str, num_walkers: int):
        """Makes the environments; each waits for its first RESET.

        Args:
            env_id: gymnasium's name of the environment.
            num_walkers: of this process.
        """
        self._envs = [gymnasium.make(env_id, disable_env_checker=True) for _ in range(num_walkers)]
        self.observation_size = _flat_size("observation", self._envs[0])
        self.action_size = _flat_size("action", self._envs[0])

    def tick(self, arrays: SharedArrays) -> None:
        """Does what is asked of each walker; the pool has cleared reward and flags."""
        action, observation, seed, reward, command, terminated, truncated = arrays
        for index, order in enumerate(command.tolist()):
            env = self._envs[index]
            if order == Command.STEP:
                answer = env.step(action[index])
                observation[index], reward[index], terminated[index], truncated[index], _ = answer
            elif order == Command.RESET:
                _forget(env)
                observation[index], _ = env.reset(seed=int(seed[index]))


def _forget(env: Any) -> None:
    """Gives a Box2D environment a new world, as `gymnasium.make` would.

    `reset` destroys the bodies but keeps the world, which orders new contacts by what it held
    before; so the solver rounds differently, and the same seed and actions give another episode
    after other episodes. The bodies are built anew at each reset anyway: this costs nothing.
    """
    env = env.unwrapped
    if hasattr(env, "world") and hasattr(env, "_destroy"):
        env._destroy()
        env.world = type(env.world)()


def _flat_size(name: str, env: Any) -> int:
    """Length of the vectors in a space of the environment."""
    space = getattr(env, f"{name}_space")
    if type(space).__name__ != "Box" or len(space.shape) != 1:
        raise ValueError(f"env_id {env.spec.id}: {name}s must be flat vectors, not {space}")
    return space.shape[0]
