"""A process that steps some of a pool's walkers; `GymnasiumPool` starts it, no person does.

It first tells the sizes of its spaces. Then each byte on stdin is a tick: commands and actions are
in the shared memory, results go there, and a byte back says that they are there. When stdin closes
it ends; so no worker outlives its pool, not even if the pool's process was killed.
"""

import gc
import os
import signal
import sys
from typing import Any

from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SIZES, SharedArrays, map_arrays


def main(
    env_id: str, memory: int, reply: int, num_walkers: int, first: int, num_workers: int
) -> None:
    """Serves walkers `first`, `first + num_workers`, ... until stdin closes.

    Args:
        env_id: gymnasium's name of the environment.
        memory: file descriptor of the shared memory; it gets its size before the first tick.
        reply: file descriptor of the pipe to the pool.
        num_walkers: N.
        first: this worker's first walker.
        num_workers: workers of the pool.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the pool's to handle.
    import gymnasium

    # Walkers leave next to no cycles, and looking for them among all terrains takes 3 % of a tick.
    gc.disable()
    envs = [
        gymnasium.make(env_id, disable_env_checker=True)
        for _ in range(first, num_walkers, num_workers)
    ]
    sizes = _flat_size("observation", envs[0]), _flat_size("action", envs[0])
    os.write(reply, SIZES.pack(*sizes))
    if not os.read(0, 1):
        return
    arrays = SharedArrays(
        *(array[first::num_workers] for array in map_arrays(memory, num_walkers, *sizes))
    )
    while True:
        _tick(envs, arrays)
        os.write(reply, b".")
        if not os.read(0, 1):
            return


def _tick(envs: list[Any], arrays: SharedArrays) -> None:
    """Does what is asked of each walker; the pool has cleared reward and flags."""
    action, observation, seed, reward, command, terminated, truncated = arrays
    for index, order in enumerate(command.tolist()):
        if order == Command.STEP:
            answer = envs[index].step(action[index])
            observation[index], reward[index], terminated[index], truncated[index], _ = answer
        elif order == Command.RESET:
            _forget(envs[index])
            observation[index], _ = envs[index].reset(seed=int(seed[index]))


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


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
