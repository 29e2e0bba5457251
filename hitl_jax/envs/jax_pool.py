"""`JaxPool`: a pool of the walkers of `hitl_jax.walker`, stepped by JAX."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import walker
from hitl_jax.envs.base import CheckedPool, Command, StepBatch
from hitl_jax.results.episode_measures import WALKER_ENDS
from hitl_jax.walker import Step, Walker
from hitl_jax.xla import full_registers, gpu
from hitl_jax.xla.devices import walker_devices
from hitl_jax.xla.threefry import make_key

MAX_LANES = 512
"""Walkers that a CPU steps at once; more do not fit into a core's cache."""


class Block(NamedTuple):
    """Walkers that are stepped together.

    Attributes:
        device: that steps them.
        start: index of the block's first walker in the pool.
        stop: index after the block's last walker.
    """

    device: jax.Device
    start: int
    stop: int


class JaxPool(CheckedPool):
    """N walkers in blocks of equal size, spread over devices.

    Attributes:
        blocks: of walkers, each on one device.
        walkers: states of each block, leaves [L, ...]; lanes beyond its walkers are unused.
        lanes: L, the rows of a block, filled up to whole vector registers (`xla.full_registers`).
    """

    seedable = True
    ends = WALKER_ENDS

    def __init__(self, num_walkers: int, num_devices: int, hardcore: bool = False):
        """Makes the walkers; compiles at the first tick.

        Args:
            num_walkers: N.
            num_devices: number of CPU devices to spread them over; accelerators are all used.
            hardcore: whether their terrain has stumps, stairs and pits.
        """
        super().__init__(num_walkers, walker.OBSERVATION_SIZE, walker.ACTION_SIZE)
        devices = walker_devices(min(num_devices, math.ceil(num_walkers / full_registers.full(1))))
        cpu = devices[0].platform == "cpu"
        needed = math.ceil(num_walkers / MAX_LANES) if cpu else 1
        share = math.ceil(num_walkers / (math.ceil(needed / len(devices)) * len(devices)))
        starts = range(0, num_walkers, share)
        self.blocks = [
            Block(devices[index % len(devices)], start, min(start + share, num_walkers))
            for index, start in enumerate(starts)
        ]
        self.lanes = full_registers.full(share)
        self.walkers = [_waiting(self.lanes, block.device, hardcore) for block in self.blocks]
        self._steps: list[Step] = []
        self._observation = np.zeros((num_walkers, self.observation_size), np.float32)

    def _start(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        self._steps = []
        for index, block in enumerate(self.blocks):
            own = slice(block.start, block.stop)
            rows = [full_registers.filled(a[own], self.lanes) for a in (command, action, seed)]
            given = jax.device_put(rows, block.device)
            self.walkers[index], step = tick(self.walkers[index], *given)
            self._steps.append(step)

    def _finish(self, command: np.ndarray) -> StepBatch:
        results = [
            [leaf[: block.stop - block.start] for leaf in jax.tree.leaves(jax.device_get(step))]
            for block, step in zip(self.blocks, self._steps, strict=True)
        ]
        observation, reward, terminated, truncated = (
            np.concatenate(leaves) for leaves in zip(*results, strict=True)
        )
        stepped = command == Command.STEP
        moved = command != Command.IDLE
        self._observation = np.where(moved[:, None], observation, self._observation)
        return StepBatch(
            self._observation.copy(),
            np.where(stepped, reward, np.float32(0)),
            terminated & stepped,
            truncated & stepped,
        )

    def walker(self, index: int) -> Walker:
        """The state of one walker, to draw it; leaves without a batch axis."""
        block, lane = divmod(index, self.blocks[0].stop)
        one: Walker = jax.tree.map(lambda leaf: leaf[lane], self.walkers[block])
        return one

    def _shutdown(self) -> None:
        jax.block_until_ready(self.walkers)  # A process that ends while a program runs crashes.
        self.walkers, self._steps = [], []


def _waiting(lanes: int, device: jax.Device, hardcore: bool) -> Walker:
    """Walkers of a block before their first RESET, leaves [L, ...]."""
    keys = jax.device_put(jnp.zeros(lanes, jnp.uint32), device)
    return new_walkers(keys, hardcore)


@functools.partial(jax.jit, static_argnums=1)
def new_walkers(seeds: jax.Array, hardcore: bool) -> Walker:
    """The walkers of episodes' seeds, before the step that ends their reset.

    Args:
        seeds: uint32 [L].
        hardcore: static; whether their terrain has stumps, stairs and pits.

    Returns:
        Their states, leaves [L, ...].
    """
    return jax.vmap(lambda seed: walker.new_walker(make_key(seed), hardcore))(seeds)


@functools.partial(jax.jit, donate_argnums=0)
def tick(
    walkers: Walker, command: jax.Array, action: jax.Array, seed: jax.Array
) -> tuple[Walker, Step]:
    """One tick of a block's walkers.

    Args:
        walkers: their states, leaves [L, ...]; donated.
        command: a `Command` for each, [L].
        action: read where the command is STEP, [L, A].
        seed: read where the command is RESET, uint32 [L].

    Returns:
        The states, and the results of the tick, leaves [L, ...]. Those of idle walkers mean
        nothing.
    """
    begins, idle = command == Command.RESET, command == Command.IDLE

    hardcore = walkers.terrain.boxes is not None

    def with_new() -> Walker:
        return _chosen(begins, new_walkers(seed, hardcore), walkers)

    # On a GPU a condition would wait for the host.
    before = with_new() if gpu.on_gpu() else jax.lax.cond(begins.any(), with_new, lambda: walkers)
    after, step = jax.vmap(walker.step)(before, jnp.where(begins[:, None], 0.0, action))
    return _chosen(idle, walkers, after), step


def _chosen(condition: jax.Array, first: Walker, second: Walker) -> Walker:
    """Walkers of `first` where a condition [L] holds, else of `second`."""

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    result: Walker = jax.tree.map(choose, first, second)
    return result
