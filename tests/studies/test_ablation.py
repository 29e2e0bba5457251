"""The command that takes the team apart: its runs, table, figure, resuming, and bad input."""

import csv
import itertools
import shutil

import numpy as np
import pytest
from small import TEAM

from hitl_jax.commands import ablation
from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.console.cli import run_main
from hitl_jax.console.progress import Progress
from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import locked
from hitl_jax.studies.ablations import runs
from hitl_jax.studies.ablations.options import AblationOptions
from hitl_jax.studies.ablations.settings import ABLATIONS, Ablation, Budget, Setting
from hitl_jax.studies.ablations.store import AREA, FALLS, LATE, Store
from hitl_jax.studies.ablations.table import Line, to_markdown
from hitl_jax.sweep import autosave, train_and_test
from hitl_jax.sweep.signals import Interrupted
from hitl_jax.training.run_spec import Divergence, FinishedRun, Run, RunSpec

_SMALL = TEAM | {"warmup_steps": 40}
_TINY = Ablation(
    "Tiny",
    (
        Setting("default", _SMALL, (Method.SRL, Method.HITL_AC)),
        Setting("slow human", _SMALL | {"delay": 10}),
    ),
)


def _run(out, *args):
    small = ["--seeds", "1", "--episodes", "2", "--test-episodes", "1", "--out", str(out)]
    return run_main("ablation", ablation.main, [*args[:1], *small, *args[1:]])


def _lines(out):
    with open(out / "runs.csv", newline="") as file:
        return list(csv.DictReader(file))


def _add_tiny(patch):
    patch.setitem(ABLATIONS, "tiny", _TINY)
    patch.setitem(ABLATIONS, "tiny-too", Ablation("Tiny too", _TINY.settings[:1]))


def _stop_at(chunk):
    """In place of what shows the progress: Ctrl-C in a chunk."""
    chunks = itertools.count(1)

    def show(*_):
        if next(chunks) == chunk:
            raise Interrupted

    return show


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        _add_tiny(patch)
        assert _run(out, "tiny") == 0
    return out


@pytest.fixture
def copied(made, tmp_path, monkeypatch):
    _add_tiny(monkeypatch)
    return shutil.copytree(made, tmp_path / "copy")


def test_runs_are_tabulated_and_drawn(made):
    table = (made / "tiny.md").read_text()
    assert [line.split(" | ")[:3] for line in table.splitlines()[-3:]] == [
        ["| default", "srl", "1"],
        ["| default", "hitl-ac", "1"],
        ["| slow human", "hitl-ac", "1"],
    ]
    assert (made / "tiny.png").exists()
    assert (made / "tiny.svg").exists()
    assert [line["episodes"] for line in _lines(made)] == ["2", "2", "2"]
    # Between that of a fall at once, where training begins, and a test after each episode.
    assert all(-130.0 < float(line[AREA]) < -90.0 for line in _lines(made))
    assert all(line[FALLS] in ("0", "1", "2") for line in _lines(made))


def test_what_is_done_is_not_done_again(copied, capsys):
    whole = _lines(copied)
    assert _run(copied, "tiny-too") == 0  # Its runs are the first ablation's.
    said = capsys.readouterr().out
    assert "finished" not in said
    assert (copied / "tiny-too.md").read_text() in said
    # A lost run is made again, by itself, with the same numbers.
    text = (copied / "runs.csv").read_text().splitlines(keepends=True)
    (copied / "runs.csv").write_text("".join(text[:-1]))
    assert _run(copied, "tiny") == 0
    assert capsys.readouterr().out.count("finished ") == 1
    for line in (*whole, *(again := _lines(copied))):
        del line["wall_seconds"]
    assert again == whole


def test_what_is_under_way_when_it_is_stopped_goes_on(made, tmp_path, capsys, monkeypatch):
    _add_tiny(monkeypatch)
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", _stop_at(5))
        patch.setattr(autosave, "git_commit", lambda: "a" * 40)
        assert _run(tmp_path, "tiny") == 130
    assert "Stopped" in capsys.readouterr().out
    assert _lines(tmp_path) == []
    monkeypatch.setattr(autosave, "git_commit", lambda: "b" * 40)
    assert _run(tmp_path, "tiny") == 0
    assert "3 runs go on where they were saved" in capsys.readouterr().out
    assert not list(tmp_path.glob("under_way*"))
    lines = [_lines(made), _lines(tmp_path)]
    assert {line["commit"] for line in lines[1]} == {"aaaaaaa+bbbbbbb"}
    for line in itertools.chain(*lines):
        del line["wall_seconds"], line["commit"]
    assert lines[0] == lines[1]


def test_saves_that_nobody_needs_are_removed(made, tmp_path, monkeypatch):
    _add_tiny(monkeypatch)
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", _stop_at(2))
        assert _run(tmp_path, "tiny") == 130
    assert list(tmp_path.glob("under_way*"))
    shutil.copy(made / "runs.csv", tmp_path)  # As if it was killed after its last run.
    assert _run(tmp_path, "tiny") == 0
    assert not list(tmp_path.glob("under_way*"))


@pytest.mark.slow
def test_saves_of_one_ablation_leave_those_of_another_alone(tmp_path, capsys, monkeypatch):
    _add_tiny(monkeypatch)
    with monkeypatch.context() as patch:
        patch.setattr(Progress, "show", _stop_at(3))
        assert _run(tmp_path, "tiny") == 130
    assert _run(tmp_path, "tiny-too") == 0
    assert "2 runs go on where they were saved" in capsys.readouterr().out
    assert _run(tmp_path, "tiny") == 0
    assert "1 runs go on where they were saved" in capsys.readouterr().out
    assert not list(tmp_path.glob("under_way*"))


def test_a_run_that_diverged_is_marked():
    spec = RunSpec(Method.SRL, 0, hyper_for(Method.SRL, Hyper()), episodes=3)
    run = Run(spec, 0, diverged=Divergence("action", 70, 0))
    finished = FinishedRun(run, {}, np.zeros(()))
    row = runs.summary_of(train_and_test.Tested(finished, [], [], 1.0, "", {}, ""))
    assert (row["diverged"], row["episodes"], row["final_return_100"]) == (1, 3, -100.0)
    text = to_markdown("Title", "", [Line("tiny", "srl", [row])])
    assert "| tiny | srl | 1 (1 diverged) |" in text


@pytest.mark.slow
def test_settings_of_one_program_are_trained_together(tmp_path, monkeypatch):
    groups, batch = [], runs.batch_of

    def nothing_of(group):
        groups.append(set(group.missing))
        return batch(group._replace(missing={}))

    monkeypatch.setattr(runs, "batch_of", nothing_of)
    assert _run(tmp_path, "all") == 0
    assert len(groups[0]) == max(map(len, groups)) > 10
    assert not set.intersection(*groups)
    names = [run.setting for run in groups[0]]
    for number in ("exploration_noise=0.1", "final_noise=0.1", "human_price=5.0"):
        assert any(number in name for name in names)
    assert not any("learner=ddpg" in name or "tested_actor=" in name for name in names)


def test_ablations_of_different_budgets_are_made_together(tmp_path, monkeypatch):
    """Each run has the episodes of its own ablation."""
    _add_tiny(monkeypatch)
    longer = Ablation("Longer", _TINY.settings[:1], Budget(1, 3, 7, 2))
    monkeypatch.setitem(ABLATIONS, "longer", longer)
    chosen = AblationOptions("all", seeds=1).chosen()
    groups = runs.missing_runs([chosen["tiny"], chosen["longer"]], Store(tmp_path / "runs.csv"))
    batches = [runs.batch_of(group) for group in groups]
    made = [
        (spec.seed, spec.episodes, batch.walkers.test_episodes)
        for batch in batches
        for spec in batch.specs
    ]
    assert sorted(made) == [(3, 7, 2)] * 2 + [(100, 160, 20)] * 3


def test_a_folder_that_is_in_use_is_refused(copied, capsys):
    with locked(copied):
        assert _run(copied, "tiny") == 2
    assert f"error: --out {copied}: is in use by process" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "a,b\n1,2\n", "{}"])
def test_a_foreign_file_is_refused(text, tmp_path):
    path = tmp_path / "runs.csv"
    path.write_text(text)
    with pytest.raises(ResultsError, match="damaged: the header is not setting,method,seed"):
        Store(path)


@pytest.mark.parametrize("lacking", [1, 2, 8])
def test_a_file_of_an_earlier_commit_is_read(copied, lacking):
    path = copied / "runs.csv"
    whole = Store(path)
    lines = path.read_text().splitlines()
    assert lines[0].endswith(f",wall_seconds,{','.join(LATE)},{AREA},{FALLS}")
    kept = [line.rsplit(",", lacking)[0] for line in lines]
    path.write_text("".join(f"{line}\n" for line in kept))
    earlier = Store(path)
    assert earlier.keys() == whole.keys()
    earlier.write()
    assert [line.rsplit(",", lacking)[0] for line in path.read_text().splitlines()] == kept


@pytest.mark.parametrize("lacking", [9, 10])
def test_a_header_that_lacks_others_is_refused(copied, lacking):
    path = copied / "runs.csv"
    lines = path.read_text().splitlines()
    path.write_text("".join(line.rsplit(",", lacking)[0] + "\n" for line in lines))
    with pytest.raises(ResultsError, match="damaged: the header is not"):
        Store(path)


def test_a_damaged_file_is_refused(copied, capsys):
    path = copied / "runs.csv"
    whole = path.read_text()
    for damaged in (whole[:-30], whole.replace("hitl-ac,100", "hitl-ac,zero")):
        path.write_text(damaged)
        assert _run(copied, "tiny-too") == 2
        said = capsys.readouterr().err
        assert said.startswith(f"error: --out {path}: damaged")
        assert path.read_text() == damaged


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["sleep"], "NAME sleep: must be one of exploration, fading"),
        (["fading", "--seeds", "0"], "--seeds 0: must be at least 1"),
        (["fading", "--episodes", "none"], "--episodes"),
        (["fading", "--first-seed", "-1"], "--first-seed -1: must be at least 0"),
        (["fading", "--out", "/dev/null/x"], "--out /dev/null/x"),
    ],
)
def test_bad_input_is_one_line(args, said, tmp_path, capsys):
    assert _run(tmp_path / "out", *args) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
