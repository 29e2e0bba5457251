"""A chunk as one program plays what the host loop plays, with a toy in the place of the walker."""

import dataclasses

import device_toy
import jax
import numpy as np
import pytest
from device_toy import CONFIG, HYPER, LOOP

from hitl_jax.config import Method, hyper_for
from hitl_jax.envs import jax_pool
from hitl_jax.team.agent import make_agent
from hitl_jax.training import device_stage, host_stage, learner_queue, rollout
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import RunSpec
from hitl_jax.xla import devices


def _specs(episodes=24, seeds=2):
    return [
        RunSpec(method, seed, hyper_for(method, HYPER), episodes, snapshots=(4,))
        for seed in range(seeds)
        for method in Method
    ]


def _play(specs, slots, saved=None, chunks=None, broken_from=device_toy.NEVER):
    """Finished runs by name, and the rollout; after so many chunks at most."""
    with device_toy.toys(broken_from):
        pool = jax_pool.JaxPool(slots, 2)
        playing = Rollout(make_agent(CONFIG), specs, pool, LOOP, saved=saved)
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
        np.testing.assert_array_equal(a.boundary, b.boundary)
    np.testing.assert_array_equal(one.boundary, other.boundary)


@pytest.fixture(scope="module")
def together():
    # Fewer slots than runs: a slot is given on as a run ends.
    finished, playing = _play(_specs(), 4)
    assert isinstance(playing._stage, device_stage.DeviceStage)
    assert len(finished) == 6
    return finished


def test_device_and_host_play_the_same(together, monkeypatch):
    monkeypatch.setattr(rollout, "make_stage", host_stage.HostStage)
    by_host, _ = _play(_specs(), 4)
    for key, run in together.items():
        _assert_same(run, by_host[key])


def test_blocks_do_not_matter(together, monkeypatch):
    monkeypatch.setattr(jax_pool, "MAX_LANES", 2)
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


def test_saving_changes_nothing(together):
    """The chunk that was begun ahead is booked early then, and a slot given on in between."""
    with device_toy.toys():
        playing = Rollout(make_agent(CONFIG), _specs(), jax_pool.JaxPool(4, 2), LOOP, saved={})
        finished = {}
        for number, done in enumerate(playing):
            finished |= {run.run.spec.key: run for run in done}
            if number % 3 == 0:
                playing.save()
    for key, run in together.items():
        _assert_same(run, finished[key])


def test_parameters_that_are_no_numbers_end_a_run_where_the_host_ends_it(together, monkeypatch):
    specs = _specs()
    sick = specs[2].hyper.replace(actor_learning_rate=1e30, critic_learning_rate=1e30)
    specs[2] = dataclasses.replace(specs[2], hyper=sick)
    on_device, _ = _play(specs, 4)
    monkeypatch.setattr(rollout, "make_stage", host_stage.HostStage)
    by_host, _ = _play(specs, 4)
    assert on_device[specs[2].key].run.diverged.quantity == "parameters"
    for key, run in on_device.items():
        assert run.run.diverged == by_host[key].run.diverged
        assert repr(run.run.episodes) == repr(by_host[key].run.episodes)
        if not run.run.diverged:
            _assert_same(run, together[key])


@pytest.mark.slow
def test_saved_runs_that_wait_for_a_slot_go_on(together):
    _, playing = _play(_specs(), 6, saved={}, chunks=4)
    saved = {run.key: run for run in playing.save()}
    assert len(saved) == 6
    rest, _ = _play(_specs(), 4, saved=saved)
    for key, run in together.items():
        _assert_same(run, rest[key])


def test_slots_of_runs_that_were_held_are_given_on(together):
    """As where runs keep their slots until they are tested, and others wait for these."""
    finished, held = {}, []
    with device_toy.toys():
        playing = Rollout(make_agent(CONFIG), _specs(), jax_pool.JaxPool(4, 2), LOOP)
        for number, done in enumerate(playing):
            finished |= {run.run.spec.key: run for run in done}
            playing.hold(done)
            held += done
            if held and (number % 5 == 0 or playing.waits()):
                playing.release(held)
                held = []
    assert len(finished) == len(together)
    for key, run in together.items():
        _assert_same(run, finished[key])


def test_a_chunk_that_is_begun_ahead_plays_the_same(together, monkeypatch):
    assert device_stage.DeviceStage.runs_ahead
    monkeypatch.setattr(device_stage.DeviceStage, "runs_ahead", False)
    finished, _ = _play(_specs(), 4)
    for key, run in together.items():
        _assert_same(run, finished[key])


@pytest.mark.slow
def test_learning_beside_a_chunk_changes_nothing(together, monkeypatch):
    """As an accelerator does, where the learner's device and the walkers' are one."""
    one = [devices.cpu_device("one")]
    for module in (device_stage, learner_queue):
        monkeypatch.setattr(module, "learning_devices", lambda: one)
    monkeypatch.setattr(jax_pool, "walker_devices", lambda count: one)
    beside, alone = [], []
    play, play_and_learn = device_stage._play, device_stage._play_and_learn
    monkeypatch.setattr(device_stage, "_play", lambda *given: alone.append(given) or play(*given))
    monkeypatch.setattr(
        device_stage,
        "_play_and_learn",
        lambda *given: beside.append(given) or play_and_learn(*given),
    )
    finished, playing = _play(_specs(), 4)
    assert playing._learner.defers and beside
    for key, run in together.items():
        _assert_same(run, finished[key])


def test_no_more_than_one_chunk_is_begun_ahead():
    with device_toy.toys():
        playing = Rollout(make_agent(CONFIG), _specs(), jax_pool.JaxPool(4, 2), LOOP)
        next(iter(playing))
        playing._stage.ticks(playing._recorder.slots, 8)
        with pytest.raises(RuntimeError, match="two are not booked"):
            playing._stage.ticks(playing._recorder.slots, 8)


def test_a_reward_that_is_no_number_ends_its_run_alone(monkeypatch):
    specs = _specs()
    # The boundary's reward is infinite then, which by itself ends no run.
    endless = specs[2].hyper.replace(alarm_reward=float("inf"))
    object.__setattr__(specs[2], "hyper", endless)  # Itself, a run refuses what is infinite.
    on_device, _ = _play(specs, 4, broken_from=12)
    ended = {run.run.diverged.quantity for run in on_device.values() if run.run.diverged}
    assert "reward" in ended
    monkeypatch.setattr(rollout, "make_stage", host_stage.HostStage)
    by_host, _ = _play(specs, 4, broken_from=12)
    for key, run in on_device.items():
        assert run.run.diverged == by_host[key].run.diverged
        assert repr(run.run.episodes) == repr(by_host[key].run.episodes)


def test_a_disagreement_of_host_and_device_is_not_passed_over():
    live = np.array([True, False])
    tick = device_stage._DeviceTick(np.zeros((2, 1)), None, live)
    with pytest.raises(RuntimeError, match="disagree"):
        tick.answer(~live)
