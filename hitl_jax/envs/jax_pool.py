"""The walkers of `hitl_jax.walker` behind the interface of all pools."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import walker
from hitl_jax.devices import walker_devices
from hitl_jax.envs.base import CheckedPool, Command, StepBatch
from hitl_jax.keys import make_key
from hitl_jax.walker import Step, Walker

_LANES = 16
"""Walkers of a block are a multiple of this: XLA rounds otherwise where a vector register is not
full, and an episode's numbers would tell how many walkers there were."""
_MOST_LANES = 2048
"""More walkers at once do not fit into a core's cache."""


class JaxPool(CheckedPool):
    """N walkers in blocks of equal size, which are shared out over devices."""

    seedable = True

    def __init__(self, num_walkers: int, num_devices: int):
        """Makes the walkers; compiles at the first tick.

        Args:
            num_walkers: N.
            num_devices: CPU devices to share them out over; an accelerator takes all.
        """
        super().__init__(num_walkers, walker.OBSERVATION_SIZE, walker.ACTION_SIZE)
        devices = walker_devices(min(num_devices, math.ceil(num_walkers / _LANES)))
        cpu = devices[0].platform == "cpu"
        needed = math.ceil(num_walkers / _MOST_LANES) if cpu else 1
        blocks = math.ceil(needed / len(devices)) * len(devices)
        self._lanes = math.ceil(num_walkers / blocks / _LANES) * _LANES
        self._devices = [devices[block % len(devices)] for block in range(blocks)]
        self._walkers = [_waiting(self._lanes, device) for device in self._devices]
        self._steps: list[Step] = []
        self._observation = np.zeros((num_walkers, self.observation_size), np.float32)

    def _start(self, command: np.ndarray, action: np.ndarray, seed: np.ndarray) -> None:
        shares = [self._shared(array) for array in (command, action, seed)]
        self._steps = []
        for index, device in enumerate(self._devices):
            given = jax.device_put([share[index] for share in shares], device)
            self._walkers[index], step = _tick(self._walkers[index], *given)
            self._steps.append(step)

    def _shared(self, array: np.ndarray) -> np.ndarray:
        """The rows [N, ...] by block [K, lanes, ...]; those that are of no walker are 0."""
        lanes = len(self._devices) * self._lanes
        padded = np.zeros((lanes, *array.shape[1:]), array.dtype)
        padded[: len(array)] = array
        return padded.reshape(len(self._devices), self._lanes, *array.shape[1:])

    def _finish(self, command: np.ndarray) -> StepBatch:
        told = [jax.tree.leaves(jax.device_get(step)) for step in self._steps]
        seen, reward, terminated, truncated = (
            np.concatenate(leaves)[: self.num_walkers] for leaves in zip(*told, strict=True)
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
        block, lane = divmod(index, self._lanes)
        one: Walker = jax.tree.map(lambda leaf: leaf[lane], self._walkers[block])
        return one

    def _shutdown(self) -> None:
        jax.block_until_ready(self._walkers)  # A process that ends under a program's feet crashes.
        self._walkers, self._steps = [], []


def _waiting(lanes: int, device: jax.Device) -> Walker:
    """Walkers that wait for their first RESET."""
    keys = jax.device_put(jnp.zeros(lanes, jnp.uint32), device)
    return _made(keys)


@jax.jit
def _made(seeds: jax.Array) -> Walker:
    return jax.vmap(lambda seed: walker.made(make_key(seed)))(seeds)


@functools.partial(jax.jit, donate_argnums=0)
def _tick(
    walkers: Walker, command: jax.Array, action: jax.Array, seed: jax.Array
) -> tuple[Walker, Step]:
    """A tick of a block of walkers; what it tells of one that is idle means nothing."""
    begins, idle = command == Command.RESET, command == Command.IDLE

    def renewed() -> Walker:
        return _chosen(begins, _made(seed), walkers)

    before = jax.lax.cond(begins.any(), renewed, lambda: walkers)
    after, step = jax.vmap(walker.step)(before, jnp.where(begins[:, None], 0.0, action))
    return _chosen(idle, walkers, after), step


def _chosen(condition: jax.Array, first: Walker, second: Walker) -> Walker:
    """Walkers of the first where a condition [lanes] holds."""

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    result: Walker = jax.tree.map(choose, first, second)
    return result
