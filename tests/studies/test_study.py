"""What a human's time brings: which runs that asks for, their tables and figure, and bad input."""

import pytest
from small import TEAM

from hitl_jax.commands import study
from hitl_jax.config import Hyper
from hitl_jax.console.cli import run_main
from hitl_jax.studies import intervening
from hitl_jax.studies.ablations.runs import missing_runs, settings_of
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.intervening import NUMBERS, StudyOptions

_TINY = (
    *("--takeover-steps", "25", "--rest", "--delay", "0", "--interventions", "5"),
    *("--seeds", "1", "--episodes", "2", "--test-episodes", "1"),
)


def _run(out, *words):
    return run_main("study", study.main, [*_TINY, *words, "--out", str(out)])


def test_each_number_is_changed_by_itself_and_the_task_is_run_once(tmp_path):
    studied = StudyOptions(seeds=3).studied()
    assert list(studied) == list(NUMBERS)
    labels = [setting.label for setting, _ in settings_of(studied["takeover_steps"])]
    assert labels == ["25", "50 (as the task has it)", "100", "200"]
    changed = {name: settings_of(one) for name, one in studied.items()}
    for settings in changed.values():
        for setting, parts in settings:
            numbers = vars(parts.hyper) | vars(parts.hyper.human)
            usual = vars(Hyper()) | vars(Hyper().human)
            differ = {name for name in numbers if numbers[name] != usual[name]} - {"human"}
            assert len(differ) == (0 if "as the task" in setting.label else 1)
    [group] = missing_runs(studied.values(), Store(tmp_path / "runs.csv"))  # One program.
    assert len(group.missing) == 3 * (3 + 2 + 3 + 2 + 2)  # SRL, and the task as it is, once.


def test_a_task_has_its_own_numbers():
    studied = StudyOptions(env="LunarLanderContinuous-v3").studied()
    _, parts = next(settings_of(studied["delay"]))
    assert parts.agent.indicator == "lander_tilt"
    assert studied["delay"].of_a_run["env"] == "LunarLanderContinuous-v3"


@pytest.mark.slow
def test_runs_are_tabulated_and_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(intervening, "_BASE", TEAM | {"warmup_steps": 40})
    assert _run(tmp_path) == 0
    said = capsys.readouterr().out
    assert "5 runs are missing" in said
    assert "| 25 | hitl-ac | 1 |" in said and "| unlimited (as the task has it) | srl | 1 |" in said
    for name in ("study.png", "study.svg", "delay.md", "delay.png", "runs.csv"):
        assert (tmp_path / name).stat().st_size > 0
    assert not (tmp_path / "rest.md").exists()
    assert _run(tmp_path) == 0
    assert "0 runs are missing" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--method", "srl"], "--method srl: must be one of hitl-ac, hitl-fix"),
        (["--env", "Hopper"], "--env Hopper: "),
        (["--delay", "33"], "--delay 33: must be "),
        (["--delay", "-1"], "--delay -1: must be "),
        (["--rest", "5", "5"], "--rest 5 5: each at most once"),
        (["--takeover-steps", "0"], "--takeover-steps 0: must be at least 1"),
        (["--seeds", "0"], "--seeds 0: must be at least 1"),
        (["--episodes", "0"], "--episodes 0: must be at least 1"),
    ],
)
def test_bad_options_are_one_line(words, said, tmp_path, capsys):
    assert _run(tmp_path / "out", *words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {said}")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
