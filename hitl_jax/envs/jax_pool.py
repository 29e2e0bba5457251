"""The walkers of `hitl_jax.walker` behind the interface of all pools."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import walker
from hitl_jax.envs.base import CheckedPool, Command, StepBatch
from hitl_jax.walker import Step, Walker, gpu
from hitl_jax.xla import full_registers
from hitl_jax.xla.devices import walker_devices
from hitl_jax.xla.threefry import make_key

_MOST_LANES = 512
"""More walkers at once do not fit into a core's cache."""


class Block(NamedTuple):
    """Walkers that are stepped together.

    Attributes:
        device: where.
        start: the first of the pool's walkers that are of it.
        stop: the first behind them.
    """

    device: jax.Device
    start: int
    stop: int


class JaxPool(CheckedPool):
    """N walkers in blocks of equal size, which are shared out over devices.

    Attributes:
        blocks: of walkers.
        walkers: of each block, leaves [L, ...]; those behind the block's own are never begun.
        lanes: L, see `xla.full_registers`.
    """

    seedable = True

    def __init__(self, num_walkers: int, num_devices: int, hardcore: bool = False):
        """Makes the walkers; compiles at the first tick.

        Args:
            num_walkers: N.
            num_devices: CPU devices to share them out over; accelerators are all used.
            hardcore: whether their terrain has stumps, stairs and pits.
        """
        super().__init__(num_walkers, walker.OBSERVATION_SIZE, walker.ACTION_SIZE)
        devices = walker_devices(min(num_devices, math.ceil(num_walkers / full_registers.full(1))))
        cpu = devices[0].platform == "cpu"
        needed = math.ceil(num_walkers / _MOST_LANES) if cpu else 1
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
        told = [
            [leaf[: block.stop - block.start] for leaf in jax.tree.leaves(jax.device_get(step))]
            for block, step in zip(self.blocks, self._steps, strict=True)
        ]
        seen, reward, terminated, truncated = (
            np.concatenate(leaves) for leaves in zip(*told, strict=True)
        )
        stepped = command == Command.STEP
        moved = command != Command.IDLE
        self._observation = np.where(moved[:, None], seen, self._observation)
        return StepBatch(
            self._observation.copy(),
            np.where(stepped, reward, np.float32(0)),
            terminated & stepped,
            truncated & stepped,
        )

    def walker(self, index: int) -> Walker:
        """One of the walkers as it is, to be drawn; leaves without a batch axis."""
        block, lane = divmod(index, self.blocks[0].stop)
        one: Walker = jax.tree.map(lambda leaf: leaf[lane], self.walkers[block])
        return one

    def _shutdown(self) -> None:
        jax.block_until_ready(self.walkers)  # A process that ends under a program's feet crashes.
        self.walkers, self._steps = [], []


def _waiting(lanes: int, device: jax.Device, hardcore: bool) -> Walker:
    """Walkers that wait for their first RESET."""
    keys = jax.device_put(jnp.zeros(lanes, jnp.uint32), device)
    return _made(keys, hardcore)


@functools.partial(jax.jit, static_argnums=1)
def _made(seeds: jax.Array, hardcore: bool) -> Walker:
    return jax.vmap(lambda seed: walker.made(make_key(seed), hardcore))(seeds)


@functools.partial(jax.jit, donate_argnums=0)
def tick(
    walkers: Walker, command: jax.Array, action: jax.Array, seed: jax.Array
) -> tuple[Walker, Step]:
    """A tick of walkers; what it tells of one that is idle means nothing.

    Args:
        walkers: leaves [L, ...]; donated.
        command: a `Command` for each, [L].
        action: [L, A].
        seed: of those that begin, uint32 [L].

    Returns:
        The walkers and what came of the tick, leaves [L, ...].
    """
    begins, idle = command == Command.RESET, command == Command.IDLE

    hardcore = walkers.terrain.boxes is not None

    def renewed() -> Walker:
        return _chosen(begins, _made(seed, hardcore), walkers)

    if gpu.uses_four_threads():  # A GPU would wait for the host to look at the condition.
        before = renewed()
    else:
        before = jax.lax.cond(begins.any(), renewed, lambda: walkers)
    after, step = jax.vmap(walker.step)(before, jnp.where(begins[:, None], 0.0, action))
    return _chosen(idle, walkers, after), step


def _chosen(condition: jax.Array, first: Walker, second: Walker) -> Walker:
    """Walkers of the first where a condition [lanes] holds."""

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    result: Walker = jax.tree.map(choose, first, second)
    return result
