"""Saves on disk: what comes back, what is kept, and what damage does."""

import re

import numpy as np
import pytest
from example_saves import SAVED_KEY, make_saved

from hitl_jax.errors import ResultsError
from hitl_jax.results.provenance import short_commit
from hitl_jax.results.run_key import RunKey
from hitl_jax.training import saved_run_store
from hitl_jax.training.saved_run import SavedRun
from hitl_jax.training.saved_run_store import Saves

_CAPACITY = 8


@pytest.fixture
def folder(tmp_path):
    """Two saves: after 4 ticks, and after 8."""
    saves = Saves(tmp_path / "saves", _CAPACITY)
    for ticks in (4, 8):
        saves.write([make_saved(ticks, 4)])
    return tmp_path / "saves"


def test_a_run_comes_back_as_it_was_saved(folder):
    runs, notes = Saves(folder, _CAPACITY).load()
    assert notes == []
    [(key, run)] = runs.items()
    assert key == SAVED_KEY
    saved = make_saved(8, 8)
    assert repr(run.facts) == repr(saved.facts)  # as text, since NaN differs from itself
    for name in SavedRun._fields[1:]:
        there = getattr(run, name)
        np.testing.assert_array_equal(there, getattr(saved, name), err_msg=name)
        assert there.dtype == getattr(saved, name).dtype


def test_only_what_the_two_newest_saves_need_is_kept(tmp_path):
    saves = Saves(tmp_path / "saves", _CAPACITY)
    other = RunKey("srl", 0)
    for number in range(1, 8):
        runs = [make_saved(4 * number, 4)] + (
            [make_saved(4 * number, 4, other)] if number < 4 else []
        )
        saves.write(runs)
        loaded, _ = Saves(tmp_path / "saves", _CAPACITY).load()
        expected = np.arange(max(4 * number - _CAPACITY, 0), 4 * number)
        assert loaded.keys() == ({SAVED_KEY, other} if number < 4 else {SAVED_KEY})
        for run in loaded.values():
            np.testing.assert_array_equal(run.frames[:, 0], expected)
    names = sorted(path.name for path in (tmp_path / "saves").iterdir())
    frames = [f"frames-00000{number}.npz" for number in (5, 6, 7)]
    assert names == [*frames, "state-000006.npz", "state-000007.npz"]
    saves.remove()
    assert not (tmp_path / "saves").exists()
    saves.remove()


def test_a_run_that_waits_is_saved_again_as_it_is(folder):
    saves = Saves(folder, _CAPACITY)
    [run] = saves.load()[0].values()
    for _ in range(5):
        saves.write([run.without_new_frames()])
    [again] = Saves(folder, _CAPACITY).load()[0].values()
    np.testing.assert_array_equal(again.frames, run.frames)


@pytest.mark.parametrize("cut", [0, 100, -1])
def test_a_damaged_save_gives_way_to_the_one_before(folder, cut):
    newest = folder / "state-000002.npz"
    newest.write_bytes(newest.read_bytes()[:cut])
    saves = Saves(folder, _CAPACITY)
    runs, [note] = saves.load()
    assert note.startswith(f"{newest}: damaged: ")
    assert "\n" not in note
    assert runs[SAVED_KEY].facts["ticks"] == 4
    saves.write([make_saved(8, 4)])
    assert Saves(folder, _CAPACITY).load()[0][SAVED_KEY].facts["ticks"] == 8
    # The damaged one has gone, the one before it has stayed.
    names = sorted(path.name for path in folder.glob("state-*"))
    assert names == ["state-000001.npz", "state-000003.npz"]


def test_a_save_of_another_version_is_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(saved_run_store, "FORMAT", saved_run_store.FORMAT - 1)
    Saves(tmp_path, _CAPACITY).write([make_saved(4, 4)])
    monkeypatch.undo()
    known = saved_run_store.FORMAT
    told = f"is of format {known - 1}, another version's: must be {known}"
    with pytest.raises(ResultsError, match=re.escape(told)):
        Saves(tmp_path, _CAPACITY).load()


def test_a_save_of_another_version_names_what_made_it(tmp_path, monkeypatch):
    run = make_saved(4, 4)
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
        assert runs[SAVED_KEY].facts["ticks"] == 4


def test_without_their_frames_saves_do_not_count_and_nothing_is_begun_anew(folder):
    (folder / "frames-000001.npz").unlink()
    files = sorted(folder.iterdir())
    with pytest.raises(ResultsError, match=r"no save can be read \(.*frames-000001.npz: No such"):
        Saves(folder, _CAPACITY).load()
    assert sorted(folder.iterdir()) == files


def test_frames_of_another_save_are_noticed(folder, tmp_path):
    other = Saves(tmp_path / "other", _CAPACITY)
    other.write([make_saved(3, 3)])
    (tmp_path / "other" / "frames-000001.npz").replace(folder / "frames-000001.npz")
    with pytest.raises(ResultsError, match=r"frames-000001\.npz is of another save"):
        Saves(folder, _CAPACITY).load()


def test_nothing_there_is_nothing_saved(tmp_path):
    assert Saves(tmp_path / "none", _CAPACITY).load() == ({}, [])
    Saves(tmp_path / "none", _CAPACITY).remove()


def test_a_run_that_waits_does_not_keep_the_frames_of_others(tmp_path):
    saves = Saves(tmp_path / "saves", _CAPACITY)
    waiting = make_saved(2, 2, RunKey("srl", 0))
    saves.write([make_saved(4, 4), waiting])
    for ticks in range(8, 40, 4):
        saves.write([make_saved(ticks, 4), waiting.without_new_frames()])
    # The first, for what waits; those that the two newest states need of the other.
    assert len(list((tmp_path / "saves").glob("frames-*"))) == 4
    runs, notes = Saves(tmp_path / "saves", _CAPACITY).load()
    assert notes == []
    assert runs[waiting.key].frames.ravel().tolist() == [0, 1]
    assert runs[SAVED_KEY].frames.ravel().tolist() == list(range(28, 36))


def test_a_removal_that_is_cut_off_leaves_nothing_to_refuse(folder, monkeypatch):
    monkeypatch.setattr("shutil.rmtree", lambda path: None)
    Saves(folder, _CAPACITY).remove()
    assert Saves(folder, _CAPACITY).load() == ({}, [])
