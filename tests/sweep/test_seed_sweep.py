"""The main job end to end, on real walkers, and what it says to careless users."""

import contextlib
import csv
import itertools
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import small
from forged import as_of_format_1, rewrite
from PIL import Image

from hitl_jax.commands import alarms, assistance, replay, verify
from hitl_jax.commands.seed_sweep import main
from hitl_jax.console.cli import run_main
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.playback.alarm_counts import NUM_BOUNDARIES
from hitl_jax.results import provenance
from hitl_jax.results.episode_tables import select, table_to_csv
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep import run_sweep
from hitl_jax.sweep.background_figures import BackgroundFigures
from hitl_jax.sweep.run_sweep import Sweep

_SMALL = [
    *("--seeds", "1", "--episodes", "3", "--test-episodes", "2", "--warmup-steps", "100"),
    *small.OPTIONS,
]


@contextlib.contextmanager
def _start(*options):
    """A sweep in a process of its own."""
    command = [sys.executable, "-m", "hitl_jax", "sweep", *_SMALL, *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command,
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,
        # What such a terminal cannot show, as a dash, is replaced.
        env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "ascii"},
    ) as sweep:
        try:
            yield sweep
        finally:
            sweep.kill()


@pytest.fixture
def undrawn(monkeypatch):
    """Sweeps whose figures nobody looks at."""
    monkeypatch.setattr(run_sweep, "draw", lambda _: [])


def _run(out, *options):
    return run_main("sweep", main, [*_SMALL, *options, "--out", str(out)])


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "[lr=0.1] $x$ [/data] :smile: τ|"
    with pytest.MonkeyPatch.context() as patch:
        # As if figures were due after each of the first chunks and steps of tests, and then after
        # every hundredth.
        calls = itertools.count()

        def prepare(figures):
            if (call := next(calls)) < 20 or call % 100 == 0:
                figures._prepare()

        patch.setattr(BackgroundFigures, "draw_if_due", prepare)
        assert _run(out) == 0
    return out


def test_everything_is_written(swept):
    folder = ResultsFolder(swept)
    runs = {run.key.method: run for run in folder.load_all()}
    assert list(runs) == ["srl", "hitl-fix", "hitl-ac"]
    for method, run in runs.items():
        assert len(run.episodes["return"]) == 3
        assert run.info["env_steps"] == run.episodes["length"].sum()
        modes = run.tests["mode"].tolist()
        assert modes == ["autonomous"] * 2 + ["assisted"] * (0 if method == "srl" else 2)
        num_modes = 1 if method == "srl" else 2
        assert run.progress["trained"].tolist() == [1, 2] * num_modes
        assert set(run.progress["mode"]) == set(modes)
        assert {"versions", "commit", "config", "wall_seconds"} <= run.info.keys()
        assert np.isnan(run.episodes["mean_boundary"]).all() == (method == "srl")
        params = folder.load_params(run.key)
        assert params["actor/params/Dense_0/kernel"].shape == (24, 16)
    assert runs["hitl-fix"].episodes["mean_boundary"] == pytest.approx(0.7)
    names = {path.name for path in swept.glob("figures/*")}
    assert {"figure4_training.png", "figure5_test.svg", "figure6_boundary.png"} <= names
    assert (swept / "summary.md").exists()
    assert (swept / "summary.csv").exists()
    assert not list(swept.glob("partial/*.csv"))


def test_alarms_are_counted_in_the_episodes_of_the_tests(swept):
    assert run_main("alarms", alarms.main, [str(swept), "--episodes", "2"]) == 0
    counted = list(csv.DictReader((swept / "alarms.csv").read_text().splitlines()))
    for run in ResultsFolder(swept).load_all():
        alone = select(run.tests, "mode", "autonomous")
        rows = [row for row in counted if row["method"] == run.key.method]
        assert len(rows) == NUM_BOUNDARIES
        assert {int(row["steps"]) for row in rows} == {alone["length"].sum()}
        assert {int(row["falls"]) for row in rows} == {alone["fall"].sum()}
        assert int(rows[0]["alarms"]) == int(rows[0]["steps"])  # a boundary of 0
    assert (swept / "figures" / "figure8_alarms.png").exists()


@pytest.mark.slow
def test_help_is_measured_on_the_terrains_of_the_tests(swept):
    assert run_main("assistance", assistance.main, [str(swept), "--episodes", "1"]) == 0
    rows = list(csv.DictReader((swept / "assistance.csv").read_text().splitlines()))
    for run in ResultsFolder(swept).load_all():
        alone = select(run.tests, "mode", "autonomous")
        own = [row for row in rows if row["method"] == run.key.method]
        if run.key.method == "srl":
            assert not own
            continue
        learned = {"learned boundary"} if run.key.method == "hitl-ac" else set()
        assert {row["rule"] for row in own} == {"alone", "fixed boundary", "chance"} | learned
        assert {row["human"] for row in own} == {"nobody", "judges", "trusts"}
        assert int(own[0]["steps"]) == alone["length"][0]
        assert float(own[0]["return_mean"]) == pytest.approx(alone["return"][0])
        assert all(int(row["human_steps"]) <= int(row["steps"]) for row in own)
    assert (swept / "figures" / "figure12_assistance.png").exists()


def _verify(folder, *options):
    return run_main("verify", verify.main, [str(folder), *options])


def _replay(folder, *options):
    return run_main("replay", replay.main, [str(folder), *options])


@pytest.mark.slow
def test_every_episode_that_is_kept_can_be_had_again(swept, tmp_path, capsys):
    assert _verify(swept, "--runs", "9") == 0
    said = capsys.readouterr().out
    assert "hitl-ac seed 0: training " in said
    assert said.endswith("of 3 of 3 runs agree\n")
    forged = tmp_path / "forged"
    shutil.copytree(swept, forged)
    path = forged / "runs/srl/seed-0000/test.csv"
    table = ResultsFolder(forged).load_run(RunKey("srl", 0)).tests
    table["return"][1] += 1e-9
    path.write_text(table_to_csv(table))
    as_of_format_1(path.parent)
    assert _verify(forged, "--runs", "9") == 1
    said = capsys.readouterr().out
    assert "srl seed 0: training 1 of 1, autonomous 1 of 2" in said


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_versions_that_differ_are_named_first_and_once(swept, tmp_path, capsys):
    other = tmp_path / "other"
    shutil.copytree(swept, other)
    for path in (other / "config.json", *other.glob("runs/*/*/run.json")):
        rewrite(path, lambda made: made["versions"].update({"jax": "0.4.1", "numpy": "1.0"}))
    now = provenance.versions()
    told = f"jax 0.4.1, now {now['jax']}; numpy 1.0, now {now['numpy']}"
    assert _verify(other, "--runs", "1") == 0
    first, *others = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{other} was made with {told}: ")
    assert others[-1].endswith(" agree")
    assert _run(other) == 0
    assert [f"{other} was begun with {told}"] == [
        line for line in capsys.readouterr().out.splitlines() if "0.4.1" in line
    ]
    assert _verify(swept, "--runs", "1") == 0
    assert "was made with" not in capsys.readouterr().out


@pytest.mark.slow
def test_a_film_shows_the_recorded_episode(swept, tmp_path, capsys):
    films = (
        (["--method", "hitl-fix"], "hitl-fix-seed-0-training"),
        (["--phase", "assisted", "--episode", "2"], "hitl-ac-seed-0-assisted-2"),
    )
    for options, name in films:
        assert _replay(swept, *options) == 0
        said = capsys.readouterr().out
        path = pathlib.Path(said.splitlines()[0])
        assert path.parent == swept / "replays"
        assert path.name.startswith(name)
        steps = int(re.search("after ([0-9]+) steps", said)[1])
        with Image.open(path) as film:
            assert film.size == (600, 400)
            assert film.n_frames == steps // 2 + 1  # Every other one, and the last.
    forged = tmp_path / "forged"
    shutil.copytree(swept, forged)
    path = forged / "runs/srl/seed-0000/episodes.csv"
    table = ResultsFolder(forged).load_run(RunKey("srl", 0)).episodes
    table["return"] += 1.0
    path.write_text(table_to_csv(table))
    as_of_format_1(path.parent)
    assert _replay(forged, "--method", "srl") == 1
    assert "not the same episode" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--method", "ppo"], "--method ppo: must be one of srl, hitl-fix, hitl-ac"),
        (["--seed", "5"], "--seed 5: finished seeds of hitl-ac are 0"),
        (["--episode", "77"], "--episode 77: recorded training episodes of hitl-ac seed 0 are "),
        (["--phase", "assisted", "--method", "srl"], "--episode 1: srl seed 0 has 0 episodes of"),
        (["--out", "film.avi"], "--out film.avi: must end in .gif or .mp4"),
        (["--width", "5"], "--width 5: must be at least 100 and at most 2000"),
        (["--human-policy", "gone.npz"], "--human-policy gone.npz: No such file"),
    ],
)
def test_an_episode_that_there_is_not(swept, options, message, capsys):
    assert _replay(swept, *options) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert message in said.err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_second_start_skips_what_is_done_and_adds_seeds(swept, capsys):
    before = (swept / "runs/srl/seed-0000/run.json").stat().st_mtime_ns
    assert _run(swept, "--methods", "srl", "--first-seed", "1") == 0
    said = capsys.readouterr().out
    assert f"results: {swept}\n" in said
    assert "finished srl seed 1" in said
    assert RunKey("srl", 1) in ResultsFolder(swept).finished()
    assert (swept / "runs/srl/seed-0000/run.json").stat().st_mtime_ns == before
    start = time.monotonic()
    assert _run(swept) == 0
    assert time.monotonic() - start < 20
    assert "finished" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_sweep_goes_on_and_ends_the_same(swept, tmp_path, capsys):
    show, evaluate, chunks = Sweep._show, HostExaminer.evaluate, itertools.count(1)

    def stop_in_training(sweep, running):
        if next(chunks) == 5:
            os.kill(os.getpid(), signal.SIGTERM)
        show(sweep, running)

    def stop_in_a_test(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return evaluate(*arguments)

    out = tmp_path / "out"
    with _start("--save-seconds", "0", "--out", str(out)) as killed:
        while not list(out.glob("under_way/state-*.npz")):
            assert killed.poll() is None, killed.communicate()[1]
            time.sleep(0.05)
        killed.kill()
    for owner, name, stop, code in (
        (Sweep, "_show", stop_in_training, 143),
        (HostExaminer, "evaluate", stop_in_a_test, 130),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(owner, name, stop)
            assert _run(out) == code
        assert list(out.glob("under_way/state-*.npz"))
        assert not list(out.glob("runs/*/*"))
    assert _run(out) == 0
    assert "3 runs go on where they were saved" in capsys.readouterr().out
    assert not (out / "under_way").exists()
    for again in ResultsFolder(out).load_all():
        run = ResultsFolder(swept).load_run(again.key)
        for name in ("episodes", "tests", "progress"):
            for column, values in getattr(run, name).items():
                np.testing.assert_array_equal(getattr(again, name)[column], values, err_msg=column)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_run_does_not_depend_on_workers_and_company(swept, tmp_path):
    assert _run(tmp_path / "alone", "--methods", "hitl-fix", "--workers", "1") == 0
    key = RunKey("hitl-fix", 0)
    one, other = (ResultsFolder(path).load_run(key) for path in (swept, tmp_path / "alone"))
    assert one.episodes["end"].tolist() == other.episodes["end"].tolist()
    for name in ("length", "return", "interventions"):
        assert one.episodes[name].tolist() == pytest.approx(other.episodes[name].tolist(), rel=1e-4)
    assert one.tests["return"].tolist() == pytest.approx(other.tests["return"].tolist(), rel=1e-3)


def test_another_configuration_is_refused_with_the_difference(swept, capsys):
    assert _run(swept, "--gamma", "0.9") == 2
    said = capsys.readouterr().err
    assert said.startswith("error: --out ")
    assert "hyper.gamma: folder has 0.98, asked for 0.9" in said


@pytest.mark.slow
def test_ctrl_c_draws_what_there_is_and_says_how_to_go_on(tmp_path):
    out = tmp_path / "out"
    with _start("--episodes", "100000", "--out", str(out)) as sweep:
        line = sweep.stdout.readline()
        while "steps/s" not in line:
            assert line, sweep.communicate()[1]
            line = sweep.stdout.readline()
        os.killpg(sweep.pid, signal.SIGINT)
        said, errors = sweep.communicate(timeout=120)
    assert sweep.returncode == 130, errors
    assert "The same command goes on" in said
    assert "Traceback" not in errors
    assert (out / "figures" / "figure4_training.png").exists()
    assert json.loads((out / "config.json").read_text())["config"]["episodes"] == 100000
