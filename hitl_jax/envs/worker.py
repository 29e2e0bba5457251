"""A process that steps some of a pool's walkers; started by `GymnasiumPool`, not by a person.

For each byte on stdin it does one tick and answers with a byte on stdout. When stdin closes it
ends, so that no worker outlives its pool, whatever way the pool's process went.
"""

import functools
import mmap
import os
import signal
import sys
import warnings
from collections.abc import Callable
from typing import Any

from hitl_jax.envs import shared
from hitl_jax.envs.base import Command


def main(arguments: list[str]) -> None:
    """Serves walkers [first, last) of N.

    Args:
        arguments: environment id, file descriptor of the memory, N, O, A, first, last.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the pool's to handle.
    env_id, *numbers = arguments
    descriptor, num_walkers, observation_size, action_size, first, last = map(int, numbers)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pygame's and pkg_resources' own, at import
        import gymnasium

        make = functools.partial(gymnasium.make, env_id, disable_env_checker=True)
        envs = [make() for _ in range(first, last)]
    memory = mmap.mmap(descriptor, shared.size(num_walkers, observation_size, action_size))
    arrays = shared.views(memory, num_walkers, observation_size, action_size)
    mine = shared.SharedArrays(*(array[first:last] for array in arrays))
    os.write(1, b".")
    while os.read(0, 1):
        _tick(make, envs, mine)
        os.write(1, b".")


def _tick(make: Callable[[], Any], envs: list[Any], arrays: shared.SharedArrays) -> None:
    arrays.reward[:] = 0.0
    arrays.terminated[:] = False
    arrays.truncated[:] = False
    commands = arrays.command.tolist()
    for index, env in enumerate(envs):
        if commands[index] == Command.STEP:
            observation, reward, terminated, truncated, _ = env.step(arrays.action[index])
            arrays.observation[index] = observation
            arrays.reward[index] = reward
            arrays.terminated[index] = terminated
            arrays.truncated[index] = truncated
        elif commands[index] == Command.RESET:
            # Box2D's world remembers earlier episodes, and the same seed then plays out otherwise.
            # A new environment costs a fortieth of a reset.
            env.close()
            envs[index] = make()
            observation, _ = envs[index].reset(seed=int(arrays.seed[index]))
            arrays.observation[index] = observation


if __name__ == "__main__":
    main(sys.argv[1:])
