"""The comparison of learners: its table, its resuming, and bad input."""

import json

import pytest
from small import TEAM

from hitl_jax.commands import tuning
from hitl_jax.console.cli import run_main
from hitl_jax.studies.tuning.options import CONFIGURATIONS
from hitl_jax.sweep.changes import changed


def _run(*args):
    return run_main("tuning", tuning.main, args)


@pytest.mark.slow
def test_measures_once_and_tabulates(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(CONFIGURATIONS, "tiny", TEAM | {"warmup_steps": 100})
    args = ["--only", "tiny", "--seeds", "1", "--ticks", "208", "--test-episodes", "2"]
    args += ["--out", str(tmp_path)]
    assert _run(*args) == 0
    first = capsys.readouterr().out
    assert first.count('{"ticks"') == 3
    assert "| tiny |" in (tmp_path / "tuning.md").read_text()
    (tmp_path / "foreign.json").write_text("{}")
    measured = json.loads((tmp_path / "tiny.json").read_text())
    asked: list[int] = []

    def measure(parts, options, tell):
        asked.append(options.test_episodes)
        return measured["stages"], measured["tests"]

    monkeypatch.setattr(tuning, "measure", measure)
    assert _run(*args) == 0
    assert asked == []
    assert _run(*args[:-2], "--out", str(tmp_path), "--test-episodes", "1") == 0
    assert asked == [1]  # another budget is another comparison
    assert "foreign" not in capsys.readouterr().out


def test_every_configuration_can_be_made():
    for changes in CONFIGURATIONS.values():
        changed(changes)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--only", "huge"], "--only huge: must be some of"),
        (["--seeds", "0"], "--seeds 0: must be at least 1"),
        (["--ticks", "10"], "--ticks 10: must be at least 48"),
        (["--out", "/dev/null/x"], "--out /dev/null/x"),
    ],
)
def test_bad_input_is_one_line(args, said, capsys):
    assert _run(*args) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
