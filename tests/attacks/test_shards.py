"""Shards that are damaged, foreign or full of other things are not merged."""

import os
import shutil
import time

import numpy as np
import pytest
from example_results import CONFIG, make_info, make_params, make_tests
from forged import rewrite

from hitl_jax.commands import merge
from hitl_jax.console.cli import run_main
from hitl_jax.results.episode_tables import EPISODE_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_files import RUN_FILES
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep import recorded_human

_RUN = "runs/srl/seed-0001"
_CONFIG = CONFIG | {"episodes": 3, "test_episodes": 1}
_LENGTH = 4


def _episodes(count):
    columns = {name: np.zeros(count) for name in EPISODE_COLUMNS} | {"end": ["fall"] * count}
    return columns | {"length": np.full(count, _LENGTH), "episode": np.arange(1, count + 1)}


def _shard(path, number, config=_CONFIG, episodes=3):
    folder = ResultsFolder(path)
    shard = {"number": number, "of": 2, "methods": ["srl"], "first_seed": 0, "seeds": 2}
    folder.create_or_resume(config, "hitl-jax sweep", shard)
    recorded = {"best": Recording(1, np.zeros((_LENGTH, 9), np.float32))}
    folder.save_run(
        RunKey("srl", number - 1),
        _episodes(episodes),
        make_tests(),
        make_params(),
        make_info(config=config),
        recordings=recorded,
        diagnostics=[{"updates": 1000, "env_steps": 2000, "episodes": 1, "q": 0.5}],
    )
    return folder


@pytest.fixture
def shards(tmp_path):
    for number in (1, 2):
        _shard(tmp_path / str(number), number)
    return tmp_path / "1", tmp_path / "2"


def _merge(shards, out, capsys):
    code = run_main("merge", merge.main, [*map(str, shards), "--out", str(out)])
    return code, capsys.readouterr().err


def test_whole_shards_are_merged(shards, tmp_path, capsys):
    assert _merge(shards, tmp_path / "out", capsys)[0] == 0
    assert len(ResultsFolder(tmp_path / "out").load_all()) == 2


def _cut(path):
    path.write_bytes(path.read_bytes()[:-30])


def _cut_at_a_line(path):
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-1]))


def _garbage(path):
    path.write_bytes(os.urandom(500))


def _linked(path):
    path.rename(path.with_suffix(".away"))
    path.symlink_to(path.with_suffix(".away"))


def _linked_to_what_nobody_may_read(path):
    path.unlink()
    path.symlink_to("/proc/1/mem")


def _pipe(path):
    path.unlink()
    os.mkfifo(path)


def _folder(path):
    path.unlink()
    path.mkdir()


_FILES = (*RUN_FILES, "run.json")
_DAMAGES = (
    _cut,
    _cut_at_a_line,
    _garbage,
    os.unlink,
    _linked,
    _linked_to_what_nobody_may_read,
    _pipe,
    _folder,
)


@pytest.mark.parametrize("damage", _DAMAGES)
@pytest.mark.parametrize("name", _FILES)
def test_a_damaged_run_is_not_merged(shards, tmp_path, capsys, name, damage):
    damage(shards[1] / _RUN / name)
    code, said = _merge(shards, tmp_path / "out", capsys)
    assert (code, said.count("\n")) == (2, 1)
    assert _RUN in said
    assert not (tmp_path / "out").exists()


def test_what_else_lies_in_a_run_is_not_copied(shards, tmp_path, capsys):
    (shards[1] / _RUN / "thesis.tex").write_text("mine")
    (shards[1] / _RUN / "more").mkdir()
    assert _merge(shards, tmp_path / "out", capsys)[0] == 0
    names = {path.name for path in (tmp_path / "out" / _RUN).iterdir()}
    assert names == {*_FILES, "README.md"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda run: run["config"]["hyper"].update(gamma=0.5), "hyper.gamma: folder has 0.5"),
        (lambda run: run["config"].update(more=1), "more: folder has 1"),
        (lambda run: run.update(seed=0), "is of another run than its folder's name"),
        (lambda run: run["files"].pop("params.npz"), "is not the file that run.json names"),
        (lambda run: run.update(diverged=True), "damaged: Expected"),
        (lambda run: run.update(wall_seconds="x"), "damaged: Expected"),
    ],
)
def test_a_run_that_was_forged_is_not_merged(shards, tmp_path, capsys, change, said):
    rewrite(shards[1] / _RUN / "run.json", change)
    code, told = _merge(shards, tmp_path / "out", capsys)
    assert (code, told.count("\n")) == (2, 1)
    assert said in told
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"of": 0}, "Expected `int` >= 1"),
        ({"methods": None}, "Expected `array`"),
        ({"methods": []}, "length >= 1"),
        ({"methods": ["srl", "srl"]}, "a method is there twice"),
        ({"methods": ["../../x"]}, "matching regex"),
        ({"number": 3}, "is none of 2"),
        ({"seeds": 10**12}, "Expected `int` <= 100000"),
        ({"first_seed": -1}, "Expected `int` >= 0"),
        ({"more": 1}, "unknown field"),
        ({"of": 100_000, "seeds": 100_000}, "asked for"),
        ({"methods": [f"m{n}" for n in range(100)], "seeds": 100_000}, "must be at most 1000000"),
    ],
)
def test_a_shard_that_cannot_be_is_refused(shards, tmp_path, capsys, change, said):
    rewrite(shards[1] / "config.json", lambda document: document["shard"].update(change))
    code, told = _merge(shards, tmp_path / "out", capsys)
    assert (code, told.count("\n")) == (2, 1)
    assert said in told


def test_many_missing_shards_are_told_soon_and_briefly(tmp_path, capsys):
    _shard(tmp_path / "1", 1)
    large = {"of": 100_000, "seeds": 100_000}
    rewrite(tmp_path / "1" / "config.json", lambda document: document["shard"].update(large))
    began = time.monotonic()
    code, said = _merge([tmp_path / "1"], tmp_path / "out", capsys)
    assert code == 2
    assert "shards 2/100000, 3/100000" in said
    assert "and 99994 more: missing" in said
    assert time.monotonic() - began < 10.0


def test_too_few_episodes_are_no_run_of_the_config(tmp_path, capsys):
    _shard(tmp_path / "1", 1)
    _shard(tmp_path / "2", 2, episodes=2)
    code, said = _merge((tmp_path / "1", tmp_path / "2"), tmp_path / "out", capsys)
    assert code == 2
    assert "has 2 training episodes: must be 3" in said


def test_shards_of_different_humans_are_not_merged(tmp_path, capsys):
    """The file of one is the other's, though their config is the same."""
    mine, yours = np.arange(5) > 2, np.arange(5) > 3
    config = _CONFIG | recorded_human.digest(mine)
    for number in (1, 2):
        recorded_human.save_to_results(_shard(tmp_path / str(number), number, config).path, mine)
    shards = tmp_path / "1", tmp_path / "2"
    assert _merge(shards, tmp_path / "out", capsys)[0] == 0
    shutil.rmtree(tmp_path / "out")
    recorded_human.write(shards[1] / "human.npz", yours)
    code, said = _merge(shards, tmp_path / "out", capsys)
    assert code == 2
    assert f"{shards[1] / 'human.npz'}: is not the human that" in said
    (shards[1] / "human.npz").unlink()
    assert _merge(shards, tmp_path / "out", capsys)[0] == 2
    assert not (tmp_path / "out").exists()
