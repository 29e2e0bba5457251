"""A chunk as one program plays what the host loop plays, with a toy in the place of the walker."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from hitl_jax import device_stage, rollout, stages
from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.envs import Command, StepBatch, jax_pool
from hitl_jax.rollout import Rollout
from hitl_jax.runs import LoopConfig, RunSpec

_CONFIG = AgentConfig(learner="td3", hidden_sizes=(16,), batch_size=16)
_HYPER = Hyper(warmup_steps=24, initial_boundary=0.5, delta_minus=0.01, delta_plus=0.01)
_LOOP = LoopConfig(capacity=256, chunk=8)
_BROKEN = 200
"""From this step of an episode on, a toy's reward is no number."""


@struct.dataclass
class _Toy:
    seed: jax.Array
    steps: jax.Array


def _waiting(lanes, device, hardcore):
    zeros = jax.device_put(jnp.zeros(lanes, jnp.uint32), device)
    return _Toy(zeros, zeros.astype(jnp.int32))


def _tick(toys, command, action, seed):
    begins, idle = command == Command.RESET, command == Command.IDLE
    seed = jnp.where(begins, seed, toys.seed)
    # A scatter, as in the walker's step: without one XLA would make one kernel of all the ticks.
    places = jnp.nonzero(begins, size=len(begins), fill_value=len(begins))[0]
    steps = (toys.steps + ~idle).at[places].set(0, mode="drop")
    phase = (seed % 13).astype(jnp.float32)[:, None] + steps[:, None] * jnp.arange(24) / 10
    observation = jnp.sin(phase) + 0.1 * action.sum(axis=1)[:, None]
    reward = jnp.where(steps >= _BROKEN, jnp.nan, observation[:, 0])
    step = StepBatch(observation, reward, steps > 5 + seed % 11, steps >= 12)
    return _Toy(seed, steps), jax_pool.Step(*step)


def _specs(episodes=24, seeds=2):
    return [
        RunSpec(method, seed, hyper_for(method, _HYPER), episodes, snapshots=(4,))
        for seed in range(seeds)
        for method in Method
    ]


def _play(specs, slots, saved=None, chunks=None):
    """Finished runs by name, and the rollout; after so many chunks at most."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax_pool, "_waiting", _waiting)
        # A function of its own each time: JAX would not see a constant that a test has changed.
        patch.setattr(jax_pool, "tick", jax.jit(lambda *given: _tick(*given)))
        patch.setattr(device_stage, "tick", _tick)
        pool = jax_pool.JaxPool(slots, 2)
        playing = Rollout(make_agent(_CONFIG), specs, pool, _LOOP, tile=2, saved=saved)
        finished = {}
        for number, done in enumerate(playing, start=1):
            finished |= {run.run.spec.key: run for run in done}
            if number == chunks:
                break
        return finished, playing


def _assert_same(one, other):
    assert repr(one.run.episodes) == repr(other.run.episodes)
    assert one.run.updates == other.run.updates > 0
    assert one.run.diverged == other.run.diverged
    jax.tree.map(np.testing.assert_array_equal, one.train, other.train)
    for a, b in zip(one.run.snapshots, other.run.snapshots, strict=True):
        jax.tree.map(np.testing.assert_array_equal, a.behavior, b.behavior)


@pytest.fixture(scope="module")
def together():
    # Fewer slots than runs: a slot is given on as a run ends.
    finished, playing = _play(_specs(), 4)
    assert isinstance(playing._stage, device_stage.DeviceStage)
    assert len(finished) == 6
    return finished


def test_device_and_host_play_the_same(together, monkeypatch):
    monkeypatch.setattr(rollout, "make_stage", stages.HostStage)
    by_host, _ = _play(_specs(), 4)
    for key, run in together.items():
        _assert_same(run, by_host[key])


def test_blocks_do_not_matter(together, monkeypatch):
    monkeypatch.setattr(jax_pool, "_MOST_LANES", 2)
    in_blocks, playing = _play(_specs(), 4)
    assert len(playing._pool.blocks) == 2
    for key, run in together.items():
        _assert_same(run, in_blocks[key])


def test_a_run_that_is_saved_goes_on_as_if_nothing_had_been(together):
    _, playing = _play(_specs(), 4, saved={}, chunks=10)
    saved = {run.key: run for run in playing.save()}
    rest, _ = _play(_specs(), 4, saved=saved)
    for key, run in together.items():
        _assert_same(run, rest[key])


def test_a_reward_that_is_no_number_ends_its_run_alone(monkeypatch):
    monkeypatch.setattr("test_device_stage._BROKEN", 12)
    specs = _specs()
    # The boundary's reward is infinite then, which by itself ends no run.
    endless = specs[2].hyper.replace(alarm_reward=float("inf"))
    specs[2] = dataclasses.replace(specs[2], hyper=endless)
    on_device, _ = _play(specs, 4)
    ended = {run.run.diverged.quantity for run in on_device.values() if run.run.diverged}
    assert "reward" in ended
    monkeypatch.setattr(rollout, "make_stage", stages.HostStage)
    by_host, _ = _play(specs, 4)
    for key, run in on_device.items():
        assert run.run.diverged == by_host[key].run.diverged
        assert repr(run.run.episodes) == repr(by_host[key].run.episodes)


def test_a_disagreement_of_host_and_device_is_not_passed_over():
    live = np.array([True, False])
    tick = device_stage._DeviceTick(np.zeros((2, 1)), None, live)
    with pytest.raises(RuntimeError, match="disagree"):
        tick.answer(~live)
