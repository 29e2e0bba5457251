"""Saves on disk: what comes back, what is kept, and what damage does."""

import dataclasses
import re

import numpy as np
import pytest
from test_results import make_episodes

from hitl_jax.errors import ResultsError
from hitl_jax.results.provenance import short_commit
from hitl_jax.results.run_key import RunKey
from hitl_jax.training import saved_run_store
from hitl_jax.training.saved_run import SavedRun
from hitl_jax.training.saved_run_store import Saves

_CAPACITY = 8
_KEY = RunKey("hitl-ac", 3)


def _run(ticks, new, key=_KEY):
    """A run after so many ticks, with its latest frames; frame t holds the number t."""
    columns = {name: np.asarray(values).tolist() for name, values in make_episodes().items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    facts = dataclasses.asdict(key) | {"ticks": ticks, "env_steps": ticks, "updates": 0}
    facts |= {"seconds": 1.5, "begun": True, "diverged": None, "recordings": {}, "episodes": rows}
    return SavedRun(
        facts=facts,
        train=np.arange(3, dtype=np.uint32),
        acting=np.arange(4, dtype=np.uint32),
        behavior=np.ones((3, 2), np.float32),
        snapshots=np.zeros((0,)),
        boundaries=np.zeros((0,)),
        observation=np.full(2, ticks, np.float32),
        steps=np.zeros((0, 9), np.float32),
        recordings=np.zeros((0, 9), np.float32),
        frames=np.arange(ticks - new, ticks, dtype=np.float32)[:, None],
    )


@pytest.fixture
def folder(tmp_path):
    """Two saves: after 4 ticks, and after 8."""
    saved_run_store = Saves(tmp_path / "saves", _CAPACITY)
    for ticks in (4, 8):
        saved_run_store.write([_run(ticks, 4)])
    return tmp_path / "saves"


def test_a_run_comes_back_as_it_was_saved(folder):
    runs, notes = Saves(folder, _CAPACITY).load()
    assert notes == []
    [(key, run)] = runs.items()
    assert key == _KEY
    saved = _run(8, 8)
    assert repr(run.facts) == repr(saved.facts)  # as text, since NaN differs from itself
    for name in SavedRun._fields[1:]:
        there = getattr(run, name)
        np.testing.assert_array_equal(there, getattr(saved, name), err_msg=name)
        assert there.dtype == getattr(saved, name).dtype


def test_only_what_the_two_newest_saves_need_is_kept(tmp_path):
    saved_run_store = Saves(tmp_path / "saves", _CAPACITY)
    other = RunKey("srl", 0)
    for number in range(1, 8):
        runs = [_run(4 * number, 4)] + ([_run(4 * number, 4, other)] if number < 4 else [])
        saved_run_store.write(runs)
        loaded, _ = Saves(tmp_path / "saves", _CAPACITY).load()
        expected = np.arange(max(4 * number - _CAPACITY, 0), 4 * number)
        assert loaded.keys() == ({_KEY, other} if number < 4 else {_KEY})
        for run in loaded.values():
            np.testing.assert_array_equal(run.frames[:, 0], expected)
    names = sorted(path.name for path in (tmp_path / "saves").iterdir())
    frames = [f"frames-00000{number}.npz" for number in (5, 6, 7)]
    assert names == [*frames, "state-000006.npz", "state-000007.npz"]
    saved_run_store.remove()
    assert not (tmp_path / "saves").exists()
    saved_run_store.remove()


def test_a_run_that_waits_is_saved_again_as_it_is(folder):
    saved_run_store = Saves(folder, _CAPACITY)
    [run] = saved_run_store.load()[0].values()
    for _ in range(5):
        saved_run_store.write([run.without_new_frames()])
    [again] = Saves(folder, _CAPACITY).load()[0].values()
    np.testing.assert_array_equal(again.frames, run.frames)


@pytest.mark.parametrize("cut", [0, 100, -1])
def test_a_damaged_save_gives_way_to_the_one_before(folder, cut):
    newest = folder / "state-000002.npz"
    newest.write_bytes(newest.read_bytes()[:cut])
    saved_run_store = Saves(folder, _CAPACITY)
    runs, [note] = saved_run_store.load()
    assert note.startswith(f"{newest}: damaged: ")
    assert "\n" not in note
    assert runs[_KEY].facts["ticks"] == 4
    saved_run_store.write([_run(8, 4)])
    assert Saves(folder, _CAPACITY).load()[0][_KEY].facts["ticks"] == 8
    # The damaged one has gone, the one before it has stayed.
    names = sorted(path.name for path in folder.glob("state-*"))
    assert names == ["state-000001.npz", "state-000003.npz"]


def test_a_save_of_another_version_is_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(saved_run_store, "FORMAT", saved_run_store.FORMAT - 1)
    Saves(tmp_path, _CAPACITY).write([_run(4, 4)])
    monkeypatch.undo()
    known = saved_run_store.FORMAT
    told = f"is of format {known - 1}, another version's: must be {known}"
    with pytest.raises(ResultsError, match=re.escape(told)):
        Saves(tmp_path, _CAPACITY).load()


def test_a_save_of_another_version_names_what_made_it(tmp_path, monkeypatch):
    run = _run(4, 4)
    facts = run.facts | {"commits": ["abc"], "versions": {"jax": "0.4.1", "numpy": np.__version__}}
    monkeypatch.setattr(saved_run_store, "FORMAT", saved_run_store.FORMAT - 1)
    Saves(tmp_path, _CAPACITY).write([run._replace(facts=facts)])
    monkeypatch.undo()
    made = saved_run_store.origin()
    now = f"now {short_commit(made['commit'])}; jax 0.4.1, now {made['versions']['jax']}"
    told = f"another version's (commit abc, {now}): must be {saved_run_store.FORMAT}"
    with pytest.raises(ResultsError, match=re.escape(told)) as caught:
        Saves(tmp_path, _CAPACITY).load()
    assert "numpy" not in str(caught.value)


@pytest.mark.parametrize("name", ["state-000002.npz", "frames-000002.npz"])
def test_every_flipped_byte_is_noticed(folder, name):
    path = folder / name
    whole = path.read_bytes()
    for place in range(0, len(whole), 97):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        runs, [note] = Saves(folder, _CAPACITY).load()
        assert note == f"{path}: damaged: its checksum is wrong"
        assert runs[_KEY].facts["ticks"] == 4


def test_without_their_frames_saves_do_not_count_and_nothing_is_begun_anew(folder):
    (folder / "frames-000001.npz").unlink()
    files = sorted(folder.iterdir())
    with pytest.raises(ResultsError, match=r"no save can be read \(.*frames-000001.npz: No such"):
        Saves(folder, _CAPACITY).load()
    assert sorted(folder.iterdir()) == files


def test_frames_of_another_save_are_noticed(folder, tmp_path):
    other = Saves(tmp_path / "other", _CAPACITY)
    other.write([_run(3, 3)])
    (tmp_path / "other" / "frames-000001.npz").replace(folder / "frames-000001.npz")
    with pytest.raises(ResultsError, match=r"frames-000001\.npz is of another save"):
        Saves(folder, _CAPACITY).load()


def test_nothing_there_is_nothing_saved(tmp_path):
    assert Saves(tmp_path / "none", _CAPACITY).load() == ({}, [])
    Saves(tmp_path / "none", _CAPACITY).remove()


def test_a_run_that_waits_does_not_keep_the_frames_of_others(tmp_path):
    saved_run_store = Saves(tmp_path / "saves", _CAPACITY)
    waiting = _run(2, 2, RunKey("srl", 0))
    saved_run_store.write([_run(4, 4), waiting])
    for ticks in range(8, 40, 4):
        saved_run_store.write([_run(ticks, 4), waiting.without_new_frames()])
    # The first, for what waits; those that the two newest states need of the other.
    assert len(list((tmp_path / "saves").glob("frames-*"))) == 4
    runs, notes = Saves(tmp_path / "saves", _CAPACITY).load()
    assert notes == []
    assert runs[waiting.key].frames.ravel().tolist() == [0, 1]
    assert runs[_KEY].frames.ravel().tolist() == list(range(28, 36))


def test_a_removal_that_is_cut_off_leaves_nothing_to_refuse(folder, monkeypatch):
    monkeypatch.setattr("shutil.rmtree", lambda path: None)
    Saves(folder, _CAPACITY).remove()
    assert Saves(folder, _CAPACITY).load() == ({}, [])
