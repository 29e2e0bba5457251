"""The command that takes the team apart: its runs, table, figure, resuming, and bad input."""

import csv

import pytest

from experiments import ablation
from experiments.ablations.settings import ABLATIONS, Ablation, Setting
from experiments.ablations.store import Store, digest
from experiments.changes import changed
from experiments.cli import run_main
from hitl_jax.config import Method
from hitl_jax.files import ResultsError

_SMALL = {"hidden_sizes": (8,), "batch_size": 8, "capacity": 400, "warmup_steps": 40}
_SETTINGS = (
    Setting("default", _SMALL, (Method.SRL, Method.HITL_AC)),
    Setting("slow human", _SMALL | {"delay": 10}),
    Setting("takeover", _SMALL | {"intervention": "takeover"}),
)


def _run(out, *args):
    small = ["--seeds", "1", "--episodes", "2", "--test-episodes", "1", "--out", str(out)]
    return run_main(ablation.AblationOptions, ablation.main, [*args[:1], *small, *args[1:]])


def _lines(out):
    with open(out / "runs.csv", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setitem(ABLATIONS, "tiny", Ablation("Tiny", _SETTINGS))
    monkeypatch.setitem(ABLATIONS, "tiny-too", Ablation("Tiny too", _SETTINGS[:2]))


def test_runs_are_made_once_tabulated_and_drawn(tiny, tmp_path, capsys):
    assert _run(tmp_path, "tiny") == 0
    said = capsys.readouterr().out
    assert said.count("finished ") == 4
    table = (tmp_path / "tiny.md").read_text()
    assert table in said
    assert [line.split(" | ")[:3] for line in table.splitlines()[-4:]] == [
        ["| default", "srl", "1"],
        ["| default", "hitl-ac", "1"],
        ["| slow human", "hitl-ac", "1"],
        ["| takeover", "hitl-ac", "1"],
    ]
    assert (tmp_path / "tiny.png").exists()
    assert (tmp_path / "tiny.svg").exists()
    assert all(line["episodes"] == "2" for line in _lines(tmp_path))

    assert _run(tmp_path, "tiny-too") == 0  # Its runs are the first ablation's.
    assert "finished" not in capsys.readouterr().out
    assert (tmp_path / "tiny-too.md").exists()
    assert _run(tmp_path, "tiny-too", "--first-seed", "1") == 0
    assert capsys.readouterr().out.count("finished ") == 3
    assert len(_lines(tmp_path)) == 7


def test_what_is_done_when_it_is_stopped_is_kept(tiny, tmp_path, capsys, monkeypatch):
    done = ablation.train_and_test

    def first_only(*args):
        runs = done(*args)
        yield next(runs)
        runs.close()
        raise KeyboardInterrupt

    monkeypatch.setattr(ablation, "train_and_test", first_only)
    assert _run(tmp_path, "tiny") == 130
    assert "Stopped" in capsys.readouterr().out
    assert len(_lines(tmp_path)) == 1
    assert (tmp_path / "tiny.md").exists()
    monkeypatch.setattr(ablation, "train_and_test", done)
    assert _run(tmp_path, "tiny") == 0
    assert capsys.readouterr().out.count("finished ") == 3


def test_every_setting_can_be_made_and_has_a_label_of_its_own():
    for one in ABLATIONS.values():
        labels = [setting.label for setting in one.settings]
        assert len(set(labels)) == len(labels)
        for setting in one.settings:
            changed(setting.changes)


def test_the_help_names_every_ablation():
    assert not [name for name in ABLATIONS if name not in ablation.AblationOptions.__doc__]


def test_a_misspelt_option_is_not_passed_over():
    with pytest.raises(ValueError, match="btach_size"):
        changed({"btach_size": 1})


def test_digests_tell_options_and_budgets_apart():
    budget = {"episodes": 3}
    digests = [
        digest(changed({}), budget),
        digest(changed({"gamma": 0.9}), budget),
        digest(changed({"delay": 10}), budget),
        digest(changed({}), {"episodes": 4}),
    ]
    assert len(set(digests)) == 4
    assert digest(changed({}), budget) == digests[0]


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "{}"])
def test_a_foreign_file_is_refused(text, tmp_path):
    path = tmp_path / "runs.csv"
    path.write_text(text)
    with pytest.raises(ResultsError, match="is not a file of this command's runs"):
        Store(path)


def test_a_damaged_file_is_refused(tiny, tmp_path, capsys):
    assert _run(tmp_path, "tiny-too") == 0
    path = tmp_path / "runs.csv"
    whole = path.read_text()
    capsys.readouterr()
    for damaged in (whole[:-30], whole.replace("hitl-ac,0", "hitl-ac,zero")):
        path.write_text(damaged)
        assert _run(tmp_path, "tiny-too") == 2
        said = capsys.readouterr().err
        assert said.startswith(f"error: --out {path}: damaged")
        assert path.read_text() == damaged


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["sleep"], "NAME sleep: must be one of methods, intervention"),
        (["delta", "--seeds", "0"], "--seeds 0: must be at least 1"),
        (["delta", "--episodes", "none"], "--episodes"),
        (["delta", "--first-seed", "-1"], "--first-seed -1: must be at least 0"),
        (["delta", "--out", "/dev/null/x"], "--out /dev/null/x"),
    ],
)
def test_bad_input_is_one_line(args, said, tmp_path, capsys):
    assert _run(tmp_path / "out", *args) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
