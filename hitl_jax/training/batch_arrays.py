"""The arrays of a batch of runs on a device, and how one run's state is packed into a row of them.

Training states, what acting remembers, and hyperparameters are packed, a row of words for each run:
each array of a call costs the host time, and each input or output of a run costs a kernel.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import SingleDeviceSharding

from hitl_jax.choices.checks import MOST_SEED, require_whole
from hitl_jax.config import RunHyper, typed
from hitl_jax.learner import replay
from hitl_jax.team import agent as agents
from hitl_jax.team.acting import ActingState, init_acting
from hitl_jax.team.agent import Agent
from hitl_jax.types import Behavior, TrainState
from hitl_jax.xla import full_registers
from hitl_jax.xla.pytree_words import pack, unpack
from hitl_jax.xla.threefry import make_key


class LearnerBatch(NamedTuple):
    """Everything on a learning device.

    Attributes:
        train: training states, packed, uint32 [R, P].
        hyper: hyperparameters, packed, uint32 [R, H].
        memory: the replay.
    """

    train: chex.Array
    hyper: chex.Array
    memory: replay.Replay


class PackedBehavior(NamedTuple):
    """What acting needs of R runs' parameters, as they lie on the learning devices.

    Attributes:
        rows: packed, [R, B].
        finite: whether all of a row is finite, bool [R].
    """

    rows: chex.Array
    finite: chex.Array


class ActingBatch(NamedTuple):
    """Everything on an acting device, packed.

    Attributes:
        state: acting states, uint32 [A, S].
        hyper: hyperparameters, uint32 [A, H].
    """

    state: chex.Array
    hyper: chex.Array


def run_keys(seed: int, method_index: int) -> tuple[chex.PRNGKey, chex.PRNGKey, chex.PRNGKey]:
    """Keys for learning, acting and testing of a run: from its method and seed alone.

    Args:
        seed: in [0, 2³²).
        method_index: see `hitl_jax.training.run_spec.method_index`.

    Raises:
        ValueError: one line, for a number out of range.
    """
    require_whole("seed", seed, at_most=MOST_SEED)
    require_whole("method_index", method_index)
    # As one program: operation by operation, the keys of a thousand runs take half a minute.
    return traced_run_keys(np.uint32(seed), np.uint32(method_index))


@jax.jit
def traced_run_keys(
    seed: chex.Array, method_index: chex.Array
) -> tuple[chex.PRNGKey, chex.PRNGKey, chex.PRNGKey]:
    """`run_keys` without checks, for numbers on a device, uint32 []."""
    key = jax.random.fold_in(make_key(seed), method_index)
    learning, acting, testing = jax.random.split(key, 3)
    return learning, acting, testing


def empty_learner(agent: Agent, num_runs: int, capacity: int, device: jax.Device) -> LearnerBatch:
    """A batch without runs, placed on one device.

    Args:
        agent: the team.
        num_runs: R, of this device.
        capacity: T, frames in the ring of each run.
        device: where their runs will learn.
    """

    def make() -> LearnerBatch:
        some = jax.eval_shape(pack, some_train(agent))
        return LearnerBatch(
            train=jnp.zeros((num_runs, *some.shape), some.dtype),
            hyper=_copies(pack(some_hyper(agent)), num_runs),
            memory=replay.init(capacity, num_runs, agent.layout),
        )

    return jax.jit(make, out_shardings=SingleDeviceSharding(device))()


def empty_acting(agent: Agent, num_runs: int, device: jax.Device) -> ActingBatch:
    """Acting without runs, placed on one device.

    Args:
        agent: the team.
        num_runs: R.
        device: where acting happens.
    """

    def make() -> ActingBatch:
        return ActingBatch(
            state=_copies(pack(some_acting(agent)), full_registers.full(num_runs)),
            hyper=_copies(pack(some_hyper(agent)), full_registers.full(num_runs)),
        )

    return jax.jit(make, out_shardings=SingleDeviceSharding(device))()


def some_acting(agent: Agent) -> ActingState:
    """An acting state of the types and shapes that every run's has."""
    return init_acting(agent, some_hyper(agent), make_key(0))


def some_hyper(agent: Agent) -> RunHyper:
    """Hyperparameters of the types that every run's have."""
    hyper: RunHyper = typed(agent.with_extra(RunHyper()))
    return hyper


def some_train(agent: Agent) -> TrainState:
    """Types and shapes of every run's training state."""
    like: TrainState = jax.eval_shape(lambda: agents.init(agent, make_key(0)))
    return like


def flat_behavior(behavior: Behavior) -> np.ndarray:
    """One run's row of what `Programs.unpack_behavior` takes, [B]."""
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(behavior)])


def pack_behavior(agent: Agent, train: chex.Array) -> PackedBehavior:
    """What acting needs of training states [R, P]."""
    behavior = agents.behavior(jax.vmap(functools.partial(unpack, some_train(agent)))(train))
    leaves = jax.tree.leaves(behavior)
    rows = jnp.concatenate([leaf.reshape(leaf.shape[0], -1) for leaf in leaves], axis=1)
    return PackedBehavior(rows, jnp.isfinite(rows).all(axis=1))


def unpack_behavior(
    agent: Agent, packed: Sequence[chex.Array], beside: chex.Array | None = None
) -> Behavior:
    """What acting needs of runs, leaves [A, ...], from arrays of some of them, [.., B]."""
    del beside  # Its device is where this runs.
    num_runs = sum(map(len, packed))
    behind = jnp.zeros(
        (full_registers.full(num_runs) - num_runs, packed[0].shape[1]), packed[0].dtype
    )
    leaves, structure = jax.tree.flatten(agents.behavior(some_train(agent)))
    ends = np.cumsum([leaf.size for leaf in leaves])
    # Split before they are joined: all is copied once.
    parts = zip(*(jnp.split(rows, ends[:-1], axis=1) for rows in (*packed, behind)), strict=True)
    return jax.tree.unflatten(
        structure,
        [
            jnp.concatenate(part).reshape(-1, *leaf.shape)
            for part, leaf in zip(parts, leaves, strict=True)
        ],
    )


def _copies(words: chex.Array, num_runs: int) -> chex.Array:
    """R copies of one run's row."""
    return jnp.broadcast_to(words, (num_runs, *words.shape))
