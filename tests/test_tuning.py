"""The comparison of learners: its table, its resuming, and bad input."""

import pytest

from experiments import tuning
from experiments.cli import run_main


def _run(*args):
    return run_main(tuning.TuningOptions, tuning.main, args)


def test_measures_once_and_tabulates(tmp_path, capsys, monkeypatch):
    changes = {"hidden_sizes": (16,), "batch_size": 16, "warmup_steps": 100}
    monkeypatch.setitem(tuning.CONFIGURATIONS, "tiny", changes)
    args = ["--only", "tiny", "--seeds", "1", "--steps", "200", "--test-episodes", "2"]
    args += ["--out", str(tmp_path)]
    assert _run(*args) == 0
    first = capsys.readouterr().out
    assert first.count('{"ticks"') == 3
    assert "| tiny |" in (tmp_path / "tuning.md").read_text()
    assert _run(*args) == 0
    assert capsys.readouterr().out.count('{"ticks"') == 0


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--only", "huge"], "--only huge: must be some of"),
        (["--seeds", "0"], "--seeds 0: must be at least 1"),
        (["--out", "/dev/null/x"], "--out /dev/null/x"),
    ],
)
def test_bad_input_is_one_line(args, said, capsys):
    assert _run(*args) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
