"""Runs that were saved, and taken up by another process, end as if nothing had happened.

The compiled programs are those of test_rollout.
"""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper
from toy import ToyPool

from hitl_jax.config import Method, hyper_for
from hitl_jax.envs import Command
from hitl_jax.human.judgement import HumanParams
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, to_columns
from hitl_jax.team.agent import make_agent
from hitl_jax.training import rollout
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec, episode_seed
from hitl_jax.training.saved_run import CannotReturn, bring_back
from hitl_jax.training.saved_run_store import Saves

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("compiled_fully")]

_CONFIG = paper_config(
    learner="td3", hidden_sizes=(16, 16), batch_size=16, n_step=2, tested_actor="average"
)
_HYPER = paper_hyper(warmup_steps=64, initial_boundary=0.5, delta_minus=0.01, delta_plus=0.01)
_LOOP = LoopConfig(capacity=128, chunk=8)
_SPECS = [
    RunSpec(method, seed, hyper_for(method, _HYPER), episodes=8, snapshots=(3, 6))
    for seed in range(2)
    for method in Method
]


@pytest.fixture(scope="module", autouse=True)
def _sampled_often():
    """Short runs have samples of their learners, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rollout, "EVERY", 4)
        yield


def _rollout(specs, slots, saved):
    return Rollout(make_agent(_CONFIG), specs, ToyPool(slots), _LOOP, saved=saved)


def _finish(rollout):
    return {run.run.spec.key: run for done in rollout for run in done}


def _assert_same(one, other):
    for name in ("ticks", "env_steps", "updates"):
        assert getattr(one.run, name) == getattr(other.run, name)
    # As text, since NaN differs from itself.
    columns = [repr(to_columns(of.run.episodes, EPISODE_COLUMNS)) for of in (one, other)]
    assert columns[0] == columns[1]
    assert repr(one.run.diagnostics) == repr(other.run.diagnostics)
    assert bool(one.run.diagnostics) == (one.run.updates > 0)
    jax.tree.map(np.testing.assert_array_equal, one.train, other.train)
    assert one.boundary == other.boundary
    assert one.run.recordings.keys() == other.run.recordings.keys() >= {"best"}
    for name, kept in one.run.recordings.items():
        assert kept.episode == other.run.recordings[name].episode
        np.testing.assert_array_equal(kept.steps, other.run.recordings[name].steps)
    assert len(one.run.snapshots) == len(other.run.snapshots) == 2
    jax.tree.map(np.testing.assert_array_equal, one.run.snapshots, other.run.snapshots)


@pytest.fixture(scope="module")
def uninterrupted():
    finished = _finish(_rollout(_SPECS, 6, None))
    assert any(run.run.diagnostics for run in finished.values())
    return finished


@pytest.fixture(scope="module")
def saved_run():
    """A run in the middle of an episode."""
    rollout = _rollout(_SPECS[:1], 2, {})
    next(iter(rollout))
    [run] = rollout.save()
    assert len(run.steps) == 7
    return run


def _load(folder):
    saves = Saves(folder, _LOOP.frames)
    runs, notes = saves.load()
    assert notes == []
    return saves, runs


def test_runs_go_on_bit_for_bit_however_often_they_are_stopped(uninterrupted, tmp_path):
    finished, ticks, late = {}, {}, set()
    # Each time with other slots and neighbours; what is played after the last save is played again.
    for slots, chunks in ((6, 10), (2, 70), (6, 1000)):
        saves, saved = _load(tmp_path)
        now = {name: run.facts["ticks"] for name, run in saved.items()}
        assert all(now[name] >= ticks.get(name, 0) for name in now)
        ticks = now
        left = [spec for spec in _SPECS if spec.key not in finished]
        waiting = {spec.key for spec in left[slots:]} & saved.keys()
        rollout = _rollout(left, slots, saved)
        for number, done in enumerate(itertools.islice(rollout, chunks)):
            late |= waiting & {run.spec.key for run in rollout.runs()}
            finished |= {run.run.spec.key: run for run in done}
            if number % 3 == 2:
                saves.write(rollout.save())
    assert late  # Runs that were saved, and had to wait for a slot.
    assert finished.keys() == uninterrupted.keys()
    for name, run in finished.items():
        _assert_same(run, uninterrupted[name])


def test_an_intervention_before_the_save_is_paid_for_after_it():
    """Of one save a chunk: with `episode` the feedback comes with the last reward."""
    config = dataclasses.replace(_CONFIG, intervention="penalty", feedback_schedule="episode")
    hyper = _HYPER.replace(human=HumanParams(delay=0, lapse_rate=0.8))  # Now and then only.
    spec = RunSpec(Method.HITL_FIX, 0, hyper_for(Method.HITL_FIX, hyper), episodes=8)
    layout = make_agent(config).layout
    frames = np.zeros((0, layout.width), np.float32)
    saved, episodes, paid_late = {}, [], 0
    while len(episodes) < 6:
        rollout = Rollout(make_agent(config), [spec], ToyPool(2), _LOOP, saved=saved)
        next(iter(rollout))
        [run] = rollout.save()
        frames, episodes = np.concatenate([frames, run.frames]), run.facts["episodes"]
        saved = {run.key: run._replace(frames=frames)}
    resets = np.flatnonzero(frames[:, layout.final] == 1.0)
    for begin, end, row in zip(resets, resets[1:], episodes, strict=False):
        episode = frames[begin + 1 : end]
        assert row["length"] == len(episode)
        assert np.isclose(episode[:, layout.reward].sum(), row["shaped_return"], rtol=1e-5)
        paid = row["shaped_return"] != row["return"]
        assert paid == (row["interventions"] > 0)
        paid_late += paid and begin // _LOOP.chunk != end // _LOOP.chunk
    assert paid_late


def test_runs_that_ended_when_they_were_saved_are_given_at_once(uninterrupted):
    rollout = _rollout(_SPECS, 6, {})
    saved = {}
    for done in rollout:
        if done:
            ended = {run.run.spec.key for run in done}
            every = {run.key: run for run in rollout.save()}
            saved |= {key: every[key] for key in ended}
    given = [run for done in _rollout(_SPECS, 2, saved) for run in done]
    assert saved == {}
    assert len(given) == len(_SPECS)
    for run in given:
        _assert_same(run, uninterrupted[run.run.spec.key])


def test_a_walker_that_comes_back_otherwise_is_noticed(saved_run):
    other = saved_run._replace(observation=saved_run.observation + np.float32(1e-3))
    with pytest.raises(CannotReturn, match="1 of 1 walkers did not come back as they were"):
        _rollout(_SPECS[:1], 2, {_SPECS[0].key: other})


def test_a_walker_that_saw_what_is_no_number_comes_back():
    """It is about to end as diverged, and must not keep the other runs from going on."""

    class Nowhere(ToyPool):
        def step(self, command, action, seed):
            answer = super().step(command, action, seed)
            return answer._replace(observation=np.full_like(answer.observation, np.nan))

    seen = np.full((1, 24), np.nan, np.float32)
    bring_back(Nowhere(1), np.zeros(1, np.uint32), {0: np.zeros((1, 4), np.float32)}, seen)


def test_a_run_that_does_not_fit_is_refused(saved_run):
    other = saved_run._replace(train=saved_run.train[:-1])
    with pytest.raises(CannotReturn, match="srl seed 0 was saved by another program"):
        _rollout(_SPECS[:1], 2, {_SPECS[0].key: other})


def test_recorded_episodes_can_be_played_again(uninterrupted):
    names = set()
    for key, finished in uninterrupted.items():
        for name, kept in finished.run.recordings.items():
            pool = ToyPool(1)
            resets = np.array([episode_seed(key.method, key.seed, kept.episode - 1)])
            pool.step(np.array([Command.RESET]), np.zeros((1, 4), np.float32), resets)
            total = 0.0
            for action in kept.actions:
                answer = pool.step(np.array([Command.STEP]), action[None], resets)
                total += float(answer.reward[0])
            row = finished.run.episodes[kept.episode - 1]
            assert total == row["return"]
            assert kept.column("control").any() == (row["interventions"] > 0)
            names.add(name)
        returns = [row["return"] for row in finished.run.episodes]
        assert finished.run.recordings["best"].episode == np.argmax(returns) + 1
    assert names == {"best", "first-intervention"}
