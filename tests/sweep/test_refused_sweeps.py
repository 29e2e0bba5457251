"""What a sweep says to careless users, before any work starts."""

import sys

import pytest
import small

from hitl_jax.commands.seed_sweep import main
from hitl_jax.console.cli import run_main


def _run(out, *options):
    given = ["--seeds", "1", "--episodes", "3", *small.OPTIONS, *options]
    return run_main("sweep", main, [*given, "--out", str(out)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--methods", "ppo"], "--methods ppo: must be some of srl, hitl-fix, hitl-ac"),
        (["--methods"], "--methods (none): must be some of"),
        (["--methods", "srl", "srl"], "--methods srl srl: each at most once"),
        (["--seeds", "0"], "--seeds 0: must be at least 1"),
        (["--seeds", "many"], "--seeds many: must be a whole number"),
        (["--episodes", "-3"], "--episodes -3: must be at least 1"),
        (["--delta-minus", "-1"], "--delta-minus -1.0: must be at least 0"),
        (["--human.delay", "99"], "--human.delay 99: must be from 0 to 32"),
        (["--preset", "huge"], "--preset huge: must be one of full, quick"),
        (["--backend", "mujoco"], "--backend mujoco: must be one of lean, gymnasium, envpool"),
        (["--learner", "sac"], "--learner sac: must be one of ddpg, td3, td3-tqc"),
        (["--updates-per-step", "0.3"], "--updates-per-step 0.3"),
        (["--human-policy", "pyproject.toml"], "is no checkpoint that can be read"),
        (["--human-policy", "missing.npz"], "is no checkpoint that can be read"),
        (["--frobnicate"], "--frobnicate"),
        # Each names the option that was given, too.
        (["--chunk", "2000"], "--capacity 2000: must be at least 4000, twice --chunk"),
        (["--boundary-low", "2"], "--boundary-high 1.5: must be at least --boundary-low 2"),
        (["--chunk", "2", "--capacity", "6"], "--n-step 4: must be at most 3, half of --capacity"),
        (
            ["--human-policy", "missing.npz", "--human-actions", "nosuch:x"],
            "--human-actions: has no meaning beside --human-policy, whose actions",
        ),
        (
            ["--human", "recorded:missing.npz", "--danger", "predictive"],
            "--danger: has no meaning beside --human recorded:FILE, whose judgements",
        ),
        (["--human", "recorded:missing.npz", "--human-parts", "delay"], "--human-parts: has no"),
        (
            ["--noise-steps", "0", "--final-noise", "0.1"],
            "--final-noise 0.1: has no meaning beside --noise-steps 0",
        ),
        (["--noise-steps", "9", "--final-noise", "-1"], "--final-noise -1.0: must be at least 0"),
        (["--human", "recorded:missing.npz", "--human.delay", "3"], "--human.delay: has no meani"),
        (["--human", "recorded:missing.npz"], "--human missing.npz: No such file"),
        (["--boundary-learner", "x"], "--boundary-learner x: must be one of printed, margin"),
        (["--margin-parts", "x"], "--margin-parts x: must be one of heavy_tails, often"),
        (["--feedback-schedule", "year"], "--feedback-schedule year: must be one of step, onset"),
        (["--unattended-every", "-1"], "--unattended-every -1: must be at least 0"),
        (["--danger", "wise"], "--danger wise: must be one of"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(options, message, tmp_path, capsys):
    assert _run(tmp_path / "out", *options) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    assert message in said.err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written(tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("mine")
    assert _run(file) == 2
    assert _run("/proc/nowhere") == 2
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("mine")
    assert _run(foreign) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("error: --out ") for line in lines)
    assert file.read_text() == "mine"


def test_a_missing_extra_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "envpool", None)
    assert _run(tmp_path / "out", "--backend", "envpool") == 2
    assert ".[fast]" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
