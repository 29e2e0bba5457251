"""Folders that are moved, linked, shared or full of other people's files."""

import os
import pathlib
import threading

import numpy as np
import pytest

from hitl_jax.errors import ResultsError
from hitl_jax.results import atomic_files
from hitl_jax.results.atomic_files import (
    LOCK,
    locked,
    remove_leftovers,
    write_bytes_atomic,
    write_folder_atomic,
    write_text_atomic,
)
from hitl_jax.results.config_diff import ConfigMismatch
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.training.saved_run_store import Saves

_CONFIG = {"hyper": {"gamma": 0.99}}
_OTHER = {"hyper": {"gamma": 0.5}}


def _everything(folder: pathlib.Path) -> dict[str, bytes]:
    every = list(folder.rglob("*"))
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in every}


def _begun(path: pathlib.Path, config: dict) -> ResultsFolder:
    folder = ResultsFolder(path)
    folder.create_or_resume(config, "hitl-jax sweep")
    return folder


def _save(folder: ResultsFolder, key: RunKey, config: dict = _CONFIG) -> None:
    info = {"config": config, "versions": {}, "commit": None}
    info |= {"wall_seconds": 1.0, "env_steps": 1, "updates": 1}
    episodes, tests = (dict.fromkeys(names, ()) for names in (EPISODE_COLUMNS, TEST_COLUMNS))
    folder.save_run(key, episodes, tests, {"actor": np.zeros(3, np.float32)}, info)


@pytest.mark.parametrize("made_anew", [False, True])
def test_a_sweep_whose_folder_was_moved_writes_nothing_in_another(tmp_path, made_anew):
    path, key = tmp_path / "out", RunKey("srl", 0)
    with locked(path):
        mine = _begun(path, _CONFIG)
        path.rename(tmp_path / "moved")
        path.mkdir()
        if made_anew:
            for name in ("config.json", LOCK):
                (path / name).write_text("another's")
            (path / "partial").mkdir()
            (path / "partial" / f"{key.file_name}.csv").write_text("another's")
        before = _everything(path)
        for write in (
            lambda: mine.write_partial(key, dict.fromkeys(EPISODE_COLUMNS, ())),
            lambda: mine.remove_partial(key),
            lambda: _save(mine, key),
            lambda: write_text_atomic(path / "summary.md", "mine"),
            lambda: write_bytes_atomic(path / "under_way" / "state-000001.npz", b"mine"),
            lambda: Saves(path / "under_way", 8).write([]),
            lambda: write_folder_atomic(path / "runs" / "srl" / "seed-0000", {"run.json": b"{}"}),
        ):
            with pytest.raises(ResultsError, match=r"out: (is not the folder that|has vanished)"):
                write()
        assert _everything(path) == before
    assert _everything(path) == before


def test_a_folder_whose_lock_was_removed_is_written_no_more(tmp_path):
    with locked(tmp_path):
        (tmp_path / LOCK).unlink()
        with pytest.raises(ResultsError, match="was removed"):
            write_text_atomic(tmp_path / "summary.md", "mine")


def test_what_a_process_writes_elsewhere_needs_no_lock(tmp_path):
    with locked(tmp_path / "out"):
        write_text_atomic(tmp_path / "outer" / "file", "mine")
    write_text_atomic(tmp_path / "out" / "later", "mine")


@pytest.mark.parametrize("kind", ["link", "dangling", "loop", "hard link", "folder", "fifo"])
def test_a_lock_that_is_no_plain_file_is_refused(tmp_path, kind):
    users = tmp_path / "thesis.tex"
    users.write_text("years of work")
    folder = tmp_path / "downloaded"
    folder.mkdir()
    lock = folder / LOCK
    if kind == "link":
        lock.symlink_to(users)
    elif kind == "dangling":
        lock.symlink_to(tmp_path / "new")
    elif kind == "loop":
        lock.symlink_to(lock)
    elif kind == "hard link":
        os.link(users, lock)
    elif kind == "folder":
        lock.mkdir()
    else:
        os.mkfifo(lock)
    with (
        pytest.raises(ResultsError, match=r"\.lock: must be a plain file of one name"),
        locked(folder),
    ):
        pass
    assert users.read_text() == "years of work"
    assert not (tmp_path / "new").exists()
    assert os.path.lexists(lock)


@pytest.mark.parametrize("name", ["summary.md", "config.json"])
def test_a_link_in_place_of_a_file_is_replaced_and_not_followed(tmp_path, name):
    users = tmp_path / "thesis.tex"
    users.write_text("years of work")
    (tmp_path / name).symlink_to(users)
    write_text_atomic(tmp_path / name, "ours")
    assert users.read_text() == "years of work"
    assert (tmp_path / name).read_text() == "ours"


def test_processes_of_one_number_write_a_file_whole(tmp_path, monkeypatch):
    """As in two containers, whose processes have the same numbers."""
    monkeypatch.setattr(os, "getpid", lambda: 7)
    path, texts = tmp_path / "summary.md", {letter * 100_000 for letter in "ab"}
    write_text_atomic(path, min(texts))
    threads = [
        threading.Thread(target=lambda t=text: [write_text_atomic(path, t) for _ in range(30)])
        for text in texts
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        assert path.read_text() in texts
    assert [entry.name for entry in tmp_path.iterdir()] == ["summary.md"]


def test_only_our_own_and_only_stale_leftovers_are_removed(tmp_path):
    kept = {".tmp-mine", ".tmp-notes.txt", ".tmp-fedcba9876543210", ".tmp-short-x", "users"}
    (tmp_path / "users").write_text("mine")
    (tmp_path / ".tmp-mine").mkdir()
    (tmp_path / ".tmp-mine" / "file").write_text("mine")
    (tmp_path / ".tmp-notes.txt").write_text("mine")
    (tmp_path / ".tmp-short-x").write_text("mine")
    (tmp_path / ".tmp-fedcba9876543210").symlink_to(tmp_path / ".tmp-mine")
    (tmp_path / ".tmp-0123456789abcdef").write_text("{")
    half = tmp_path / ".tmp-0123456789abcde0"
    half.mkdir()
    (half / "run.json").write_text("{")
    remove_leftovers(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == kept
    assert (tmp_path / ".tmp-mine" / "file").exists()


@pytest.mark.parametrize("syncing", ["file", "folder"])
def test_what_another_process_is_writing_stays(tmp_path, monkeypatch, syncing):
    """A drawing under way, when a sweep starts in its folder."""
    real = os.fsync

    def cleaning(descriptor):
        remove_leftovers(tmp_path)
        real(descriptor)

    monkeypatch.setattr(os, "fsync", cleaning)
    if syncing == "file":
        write_text_atomic(tmp_path / "figure.svg", "<svg/>")
        assert (tmp_path / "figure.svg").read_text() == "<svg/>"
    else:
        write_folder_atomic(tmp_path / "seed-0001", {"a": b"1", "b": b"2"})
        assert (tmp_path / "seed-0001" / "b").read_bytes() == b"2"


@pytest.mark.parametrize("linked", [False, True])
def test_runs_under_way_on_another_disk_by_a_link(tmp_path, linked):
    scratch, path = tmp_path / "scratch", tmp_path / "out" / "under_way"
    path.parent.mkdir()
    if linked:
        scratch.mkdir()
        path.symlink_to(scratch)
    saves = Saves(path, capacity=8)
    assert saves.load() == ({}, [])
    saves.write([])
    assert list(path.iterdir())
    saves.remove()
    assert path.is_symlink() == linked
    assert path.exists() == linked
    assert not linked or not list(scratch.iterdir())


def test_files_of_others_among_saves_stay(tmp_path):
    path = tmp_path / "under_way"
    saves = Saves(path, capacity=8)
    saves.write([])
    (path / "notes.txt").write_text("mine")
    saves.remove()
    assert [entry.name for entry in path.iterdir()] == ["notes.txt"]


def test_a_run_of_another_config_is_refused(tmp_path):
    folder, other = _begun(tmp_path / "out", _CONFIG), _begun(tmp_path / "other", _OTHER)
    _save(other, RunKey("srl", 0), _OTHER)
    assert other.load_all()
    (other.path / "runs").rename(folder.path / "runs")
    with pytest.raises(ConfigMismatch, match=r"run\.json: made with another config: hyper\.gamma"):
        folder.load_all()


def test_a_folder_that_is_moved_before_it_is_begun_is_not_made_anew(tmp_path):
    path = tmp_path / "out"
    with locked(path):
        path.rename(tmp_path / "moved")
        with pytest.raises(ResultsError, match="is not the folder that this process has locked"):
            _begun(path, _CONFIG)
    assert not path.exists()


@pytest.mark.parametrize("name", ["seed-0000", "seed-00000", "seed-٠٠٠٠", "seed-0000.csv"])
def test_a_folder_without_a_run_is_no_finished_run(tmp_path, name):
    """As an interrupted download leaves it: what is under way must not be given up for it."""
    folder = _begun(tmp_path, _CONFIG)
    (tmp_path / "runs" / "srl" / name).mkdir(parents=True)
    assert folder.finished() == set()
    wanted = [RunKey("srl", 0)]
    if name == "seed-0000":
        with pytest.raises(ResultsError, match="seed-0000: is there and holds no finished run"):
            folder.require_free(wanted)
        (tmp_path / "runs" / "srl" / name).rmdir()
    folder.require_free(wanted)
    _save(folder, *wanted)
    assert folder.finished() == set(wanted)
    folder.require_free(wanted)


@pytest.mark.parametrize("number", ["9999999999999", "٠٠٠٠٠٩", "0000000001", "1"])
def test_files_of_other_names_are_no_saves(tmp_path, number):
    (tmp_path / f"frames-{number}.npz").write_bytes(b"mine")
    (tmp_path / f"state-{number}.npz").write_bytes(b"mine")
    saves = Saves(tmp_path, capacity=8)
    assert saves.load() == ({}, [])
    saves.write([])
    assert (tmp_path / "state-000001.npz").exists()
    assert Saves(tmp_path, capacity=8).load() == ({}, [])
    saves.remove()
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_removed_before_it_is_locked_is_written_again(tmp_path, monkeypatch, kind):
    """By a process that takes it for a leftover."""
    opened, left = atomic_files.os.open, 2

    def open_and_lose(path, *arguments, **more):
        nonlocal left
        descriptor = opened(path, *arguments, **more)
        if ".tmp-" in str(path) and left:
            left -= 1
            remove_leftovers(tmp_path)
        return descriptor

    monkeypatch.setattr(atomic_files.os, "open", open_and_lose)
    if kind == "file":
        write_bytes_atomic(tmp_path / "run.json", b"{}")
        assert (tmp_path / "run.json").read_bytes() == b"{}"
    else:
        write_folder_atomic(tmp_path / "seed-0000", {"run.json": b"{}"})
        assert (tmp_path / "seed-0000" / "run.json").read_bytes() == b"{}"
    assert len(list(tmp_path.iterdir())) == 1
