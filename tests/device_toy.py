"""A toy in the place of the walker on the device: quick to compile."""

import contextlib

import jax
import jax.numpy as jnp
import pytest
from flax import struct
from paper_team import paper_config, paper_hyper

from hitl_jax.envs import Command, StepBatch, jax_pool
from hitl_jax.training import device_ticks
from hitl_jax.training.run_spec import LoopConfig

NEVER = 200


@struct.dataclass
class _Toy:
    seed: jax.Array
    steps: jax.Array


def _waiting(lanes, device, hardcore):
    zeros = jax.device_put(jnp.zeros(lanes, jnp.uint32), device)
    return _Toy(zeros, zeros.astype(jnp.int32))


def _tick(broken_from, toys, command, action, seed):
    begins, idle = command == Command.RESET, command == Command.IDLE
    seed = jnp.where(begins, seed, toys.seed)
    # A scatter, as in the walker's step: without one XLA would make one kernel of all the ticks.
    places = jnp.nonzero(begins, size=len(begins), fill_value=len(begins))[0]
    steps = (toys.steps + ~idle).at[places].set(0, mode="drop")
    phase = (seed % 13).astype(jnp.float32)[:, None] + steps[:, None] * jnp.arange(24) / 10
    push = jnp.where(begins, 0.0, action.sum(axis=1))  # No action counts in a reset.
    observation = jnp.sin(phase) + 0.1 * push[:, None]
    reward = jnp.where(steps >= broken_from, jnp.nan, observation[:, 0])
    step = StepBatch(observation, reward, steps > 5 + seed % 11, steps >= 12)
    return _Toy(seed, steps), jax_pool.Step(*step)


@contextlib.contextmanager
def toys(broken_from=NEVER):
    """Pools of toys; from this step of an episode on their reward is no number."""

    def tick(*given):
        # A function of its own each time: JAX would not see another `broken_from`.
        return _tick(broken_from, *given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax_pool, "_waiting", _waiting)
        patch.setattr(jax_pool, "tick", jax.jit(tick))
        patch.setattr(device_ticks, "tick", tick)
        yield


CONFIG = paper_config(learner="td3", hidden_sizes=(16,), batch_size=16, tested_actor="average")


HYPER = paper_hyper(warmup_steps=24, initial_boundary=0.5, delta_minus=0.01, delta_plus=0.01)


LOOP = LoopConfig(capacity=256, chunk=8)
