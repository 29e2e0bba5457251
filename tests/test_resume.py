"""Runs that were saved, and taken up by another process, end as if nothing had happened."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
from toy import ToyPool

from hitl_jax.agent import make_agent
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.results import RunKey
from hitl_jax.rollout import LoopConfig, Rollout, RunSpec
from hitl_jax.saved import CannotReturn
from hitl_jax.saves import Saves
from hitl_jax.tables import EPISODE_COLUMNS, to_columns

_CONFIG = AgentConfig(hidden_sizes=(16, 16), batch_size=16, n_step=2)
_HYPER = Hyper(warmup_steps=64, initial_boundary=0.5, delta_minus=0.01, delta_plus=0.01)
_LOOP = LoopConfig(capacity=128, chunk=8)  # so small that a run fills it several times
_SPECS = [
    RunSpec(method, seed, hyper_for(method, _HYPER), episodes=12, snapshots=(3, 6))
    for seed in range(2)
    for method in Method
]


def _rollout(specs, slots, saved):
    return Rollout(make_agent(_CONFIG), specs, ToyPool(slots), _LOOP, tile=2, saved=saved)


def _finish(rollout):
    return {run.run.spec.name: run for done in rollout for run in done}


def _assert_same(one, other):
    for name in ("ticks", "env_steps", "updates"):
        assert getattr(one.run, name) == getattr(other.run, name)
    # As text, since NaN differs from itself.
    columns = [repr(to_columns(of.run.episodes, EPISODE_COLUMNS)) for of in (one, other)]
    assert columns[0] == columns[1]
    jax.tree.map(np.testing.assert_array_equal, one.train, other.train)
    assert one.boundary == other.boundary
    assert len(one.run.snapshots) == len(other.run.snapshots) == 2
    jax.tree.map(np.testing.assert_array_equal, one.run.snapshots, other.run.snapshots)


@pytest.fixture(scope="module")
def uninterrupted():
    return _finish(_rollout(_SPECS, 6, None))


def _load(folder):
    saves = Saves(folder, _LOOP.frames)
    runs, notes = saves.load()
    return saves, {(Method(key.method), key.seed): run for key, run in runs.items()}, notes


def test_runs_go_on_bit_for_bit_however_often_they_are_stopped(uninterrupted, tmp_path):
    finished = {}
    # Saved at every few chunks, stopped at any of them; each time with other slots and neighbours.
    for slots, chunks in itertools.cycle([(4, 7), (6, 5), (2, 9)]):
        saves, saved, notes = _load(tmp_path / "saves")
        assert notes == []
        left = [spec for spec in _SPECS if spec.name not in finished]
        if not left:
            break
        rollout = _rollout(left, slots, saved)
        for number, done in enumerate(itertools.islice(rollout, chunks)):
            finished |= {run.run.spec.name: run for run in done}
            if number % 2 == 0:
                saves.write(rollout.save())
    assert finished.keys() == uninterrupted.keys()
    for name, run in finished.items():
        _assert_same(run, uninterrupted[name])


def _two_saves(folder):
    saves, saved, _ = _load(folder)
    rollout = _rollout(_SPECS[:2], 2, saved)
    chunks = iter(rollout)
    for _ in range(2):
        for _ in range(6):
            next(chunks)
        saves.write(rollout.save())


def test_a_damaged_save_gives_way_to_the_one_before(uninterrupted, tmp_path):
    _two_saves(tmp_path)
    newest = tmp_path / "state-000002.npz"
    data = bytearray(newest.read_bytes())
    data[len(data) // 2] ^= 1
    newest.write_bytes(data)
    _, saved, [note] = _load(tmp_path)
    assert note.startswith(f"{newest}: damaged: ")
    assert {run.facts["ticks"] for run in saved.values()} == {48}
    for name, run in _finish(_rollout(_SPECS[:2], 2, saved)).items():
        _assert_same(run, uninterrupted[name])


@pytest.mark.parametrize("kind", ["state", "frames"])
@pytest.mark.parametrize("left", [0, 100, -1])
def test_nothing_is_taken_up_from_files_that_are_cut_short(tmp_path, kind, left):
    _two_saves(tmp_path)
    for path in tmp_path.glob(f"{kind}-*.npz"):
        path.write_bytes(path.read_bytes()[:left])
    _, saved, notes = _load(tmp_path)
    assert saved == {}
    assert len(notes) == 2
    assert all(note.count("\n") == 0 for note in notes)


def test_old_files_are_removed_and_the_folder_at_the_end(tmp_path):
    saves, _, _ = _load(tmp_path / "saves")
    rollout = _rollout(_SPECS[:1], 2, {})
    chunks = iter(rollout)
    for _ in range(30):
        next(chunks)
        saves.write(rollout.save())
    states = sorted(path.name for path in (tmp_path / "saves").glob("state-*"))
    assert states == ["state-000029.npz", "state-000030.npz"]
    # 128 frames are 16 chunks; the state before the newest needs those up to number 29.
    assert len(list((tmp_path / "saves").glob("frames-*"))) == 17
    assert saves.load()[0].keys() == {RunKey("srl", 0)}
    saves.remove()
    assert not (tmp_path / "saves").exists()


def test_a_walker_that_comes_back_otherwise_is_noticed(tmp_path):
    saves, _, _ = _load(tmp_path)
    rollout = _rollout(_SPECS[:1], 2, {})
    next(iter(rollout))
    [run] = rollout.save()
    saves.write([run._replace(observation=run.observation + 1e-3)])
    _, saved, _ = _load(tmp_path)
    with pytest.raises(CannotReturn, match="1 of 1 walkers did not come back as they were"):
        _rollout(_SPECS[:1], 2, saved)


def test_a_run_that_does_not_fit_is_refused(tmp_path):
    rollout = _rollout(_SPECS[:1], 2, {})
    next(iter(rollout))
    [run] = rollout.save()
    wider = dataclasses.replace(_CONFIG, hidden_sizes=(32, 16))
    with pytest.raises(CannotReturn, match="srl seed 0 was saved by another program"):
        Rollout(make_agent(wider), _SPECS[:1], ToyPool(2), _LOOP, 2, {_SPECS[0].name: run})
