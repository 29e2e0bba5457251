"""The learner of one live run: it learns from each chunk while the next one is played."""

import dataclasses
import functools
import math
from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from hitl_jax.config import RunHyper
from hitl_jax.learner import replay
from hitl_jax.team import agent as agents
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import LoopConfig
from hitl_jax.types import Behavior, TrainState
from hitl_jax.xla.devices import learning_devices

LAG = 1
"""Calls of the learner that may run while the walker plays. As in a sweep, a run always acts with
parameters of this age, so that its numbers do not depend on the speed of the machine."""

_MIN_COMPILED = 16
"""Frames of the smallest `overwrite` that is compiled."""


class BackgroundLearner:
    """Keeps the training state of one run, its replay, and the parameters that act meanwhile.

    Attributes:
        updates: of the task learner so far.
    """

    def __init__(self, agent: Agent, hyper: RunHyper, loop: LoopConfig, train: TrainState):
        """Puts the training state and an empty replay on the first learning device.

        Args:
            agent: the team.
            hyper: the run's hyperparameters, typed host scalars.
            loop: how much it learns.
            train: the training state at the start.
        """
        self._agent, self._loop = agent, loop
        self._num_updates = loop.num_updates(agent.learner.policy_delay)
        memory = replay.init(loop.frames, 1, agent.layout)
        # Copies: at the start the targets and the averaged actor are the networks' own arrays, and
        # an update donates its arguments, each of which must then be another.
        self._train, self._memory, self._hyper = jax.device_put(
            (train, memory, hyper), learning_devices()[0], may_alias=False
        )
        first, self._unravel = ravel_pytree(agents.behavior(train))
        self._behavior: deque[jax.Array] = deque([first] * (LAG + 1))
        self.updates = 0

    @property
    def behavior(self) -> Behavior:
        """The parameters that act in this chunk, on the host; waits for the learner."""
        # Through NumPy, so that no program of the learner's device has to run.
        flat = jnp.asarray(np.asarray(self._behavior[0]))
        acts: Behavior = jax.tree.map(np.asarray, self._unravel(flat))
        return acts

    def train(self) -> TrainState:
        """The training state without its key; waits for the learner."""
        state: TrainState = jax.device_get(dataclasses.replace(self._train, key=None))
        return state

    def add_chunk(self, frames: np.ndarray, learn: bool) -> None:
        """Adds a chunk to the replay, and makes the next parameters act; does not wait.

        Args:
            frames: of the chunk, [U, W].
            learn: whether to learn from the replay now.
        """
        self._memory = _add(self._memory, frames[None])
        learned = self._behavior[-1]
        if learn:
            self._train, learned = self._learn(self._train, self._memory)
            self.updates += self._num_updates
        self._behavior.append(learned)
        self._behavior.popleft()

    def overwrite(self, places: np.ndarray, outcome: np.ndarray) -> None:
        """Replaces the stored columns of frames from the reward on.

        Args:
            places: in the replay, int [K].
            outcome: the new columns, [K, 7].
        """
        # A few sizes, since each is compiled. Places past the end of the replay are dropped.
        size = _MIN_COMPILED * 4 ** max(math.ceil(math.log(len(places) / _MIN_COMPILED, 4)), 0)
        at = np.full(size, self._loop.frames, np.int32)
        rows = np.zeros((size, outcome.shape[1]), np.float32)
        at[: len(places)], rows[: len(places)] = places, outcome
        self._memory = _overwrite(self._memory, at, rows)

    def stored(self) -> np.ndarray:
        """All frames of the replay, [T, W]; waits for the learner."""
        return np.concatenate([self._memory.seen[0], self._memory.outcome[0]], axis=1)

    def compile(self) -> None:
        """Compiles all programs; nothing is learned or stored."""
        memory = jax.tree.map(jnp.copy, self._memory)
        shape = (1, self._loop.chunk, memory.seen.shape[2] + memory.outcome.shape[2])
        memory = _add(memory, np.zeros(shape, np.float32))
        self._learn(jax.tree.map(jnp.copy, self._train), memory)
        at = np.full(_MIN_COMPILED, self._loop.frames, np.int32)
        _overwrite(memory, at, np.zeros((_MIN_COMPILED, memory.outcome.shape[2]), np.float32))

    def _learn(self, train: TrainState, memory: replay.Replay) -> tuple[TrainState, jax.Array]:
        return _learn(self._agent, self._num_updates, train, memory, self._hyper)


_add = jax.jit(replay.add, donate_argnums=0)


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=2)
def _learn(
    agent: Agent, num_updates: int, train: TrainState, memory: replay.Replay, hyper: RunHyper
) -> tuple[TrainState, jax.Array]:
    """The training state after a call of the learner, and its acting parameters in one array."""
    train = agents.learn(agent, hyper, train, memory, jnp.int32(0), num_updates)
    return train, ravel_pytree(agents.behavior(train))[0]


@functools.partial(jax.jit, donate_argnums=0)
def _overwrite(memory: replay.Replay, places: jax.Array, rows: jax.Array) -> replay.Replay:
    outcome = memory.outcome.at[0, places].set(rows, mode="drop")
    return dataclasses.replace(memory, outcome=outcome)
