"""The measures of a run worked by hand, and what the report says about few or no runs."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from hitl_jax.analysis.summary import SUMMARY_COLUMNS, summarise, summarise_run, write_summary
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey

INFO = {"config": {"a": 1}, "versions": {}, "commit": None, "env_steps": 1, "updates": 1}


@pytest.fixture
def folder(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume({"a": 1}, "command")
    return folder


def table(names: tuple[str, ...], count: int, **columns: Any) -> dict[str, Any]:
    """Zeros, but for what is given."""
    zeros = dict.fromkeys(names, np.zeros(count)) | {"end": ["fall"] * count}
    return {name: columns.get(name, zeros.get(name)) for name in names}


def save(
    folder, method="hitl-ac", seed=0, test_return=250.0, boundary=0.5, returns=None, lost_tests=0
):
    """120 episodes of 10 steps: twenty of 0, then a hundred of 150, unless `returns` are given."""
    returns = np.r_[np.zeros(20), np.full(100, 150.0)] if returns is None else returns
    count = len(returns)
    episodes = table(
        EPISODE_COLUMNS,
        count,
        **{"return": returns},
        env_steps=10 * np.arange(1, count + 1),
        interventions=np.ones(count),
        human_steps=np.full(count, 2),
        true_alarms=np.full(count, 3),
        false_alarms=np.ones(count),
        final_boundary=np.full(count, boundary),
    )
    tests = table(
        TEST_COLUMNS,
        5,
        mode=["autonomous"] * 3 + ["assisted"] * 2,
        **{"return": np.array([test_return - 30.0, test_return, test_return + 30.0, 1.0, 3.0])},
        length=np.array([100, 100, 100, 30, 10]),
        fall=np.array([1, 1, 0, 1, 1]),
        interventions=np.array([0, 0, 0, 2, 1]),
        human_steps=np.array([0, 0, 0, 3, 1]),
        alarms=np.array([8, 0, 4, 99, 99]),
        alarms_before_fall=np.array([6, 0, 0, 99, 99]),
        lead_steps=np.array([20.0, np.nan, np.nan, 40.0, 40.0]),
        mean_boundary=np.full(5, boundary),
    )
    folder.save_run(
        RunKey(method, seed),
        episodes,
        tests,
        {"w": np.zeros(1)},
        INFO | {"wall_seconds": 7.0, "lost_tests": lost_tests},
    )


def test_the_measures_of_a_run_by_hand(folder):
    save(folder)
    [row] = summarise(folder)
    assert tuple(row) == SUMMARY_COLUMNS
    assert row == {
        "method": "hitl-ac",
        "seed": 0,
        "episodes": 120,
        "env_steps": 1200,
        "final_return_100": 150.0,
        "best_return_100": 150.0,
        # The first full window is that of episode 100, mean 80·150/100 = 120.
        "episodes_to_0": 100,
        "steps_to_0": 1000,
        "episodes_to_100": 100,
        "steps_to_100": 1000,
        "episodes_to_200": None,
        "steps_to_200": None,
        "episodes_to_300": None,
        "steps_to_300": None,
        "test_return_mean": 250.0,
        # √((30² + 0 + 30²) / 3), the spread of the population.
        "test_return_std": pytest.approx(np.sqrt(600.0)),
        "test_fall_rate": pytest.approx(2 / 3),
        "assisted_return_mean": 2.0,
        "assisted_takeover_rate": 4 / 40,
        "assisted_interventions_per_episode": 1.5,
        "train_interventions": 120,
        "train_human_steps": 240,
        "alarm_agreement": 0.75,
        # Of 12 alarms without a human 6 came in time; of two falls one had an alarm, 20 steps
        # before, 0.4 s at 50 steps a second.
        "alarm_precision": 0.5,
        "alarm_recall": 0.5,
        "alarm_lead_steps": 20.0,
        "alarm_lead_seconds": 0.4,
        "final_boundary": 0.5,
        "diverged": 0,
        "wall_seconds": 7.0,
    }


def test_a_short_run_has_no_passage_but_a_mean(folder):
    save(folder, returns=np.array([300.0, 0.0]))
    [row] = summarise(folder)
    assert row["final_return_100"] == row["best_return_100"] == 150.0
    assert row["episodes_to_0"] is None


def test_without_an_arbiter_alarms_are_not_judged(folder):
    episodes = table(EPISODE_COLUMNS, 1, mean_boundary=[np.nan], final_boundary=[np.nan])
    columns = {"mode": ["autonomous"], "fall": [1], "lead_steps": [np.nan]}
    tests = table(TEST_COLUMNS, 1, **columns, mean_boundary=[np.nan])
    folder.save_run(RunKey("srl", 0), episodes, tests, {}, INFO | {"wall_seconds": 1.0})
    [row] = summarise(folder)
    alarms = [name for name in SUMMARY_COLUMNS if name.startswith("alarm")]
    assert {row[name] for name in [*alarms, "final_boundary", "assisted_return_mean"]} == {None}


def test_an_empty_run_is_summarised(folder):
    nothing = table(EPISODE_COLUMNS, 0), table(TEST_COLUMNS, 0, mode=[])
    folder.save_run(RunKey("srl", 0), *nothing, {}, INFO | {"wall_seconds": 1.0})
    [row] = summarise(folder)
    assert row["env_steps"] is row["best_return_100"] is row["test_return_mean"] is None
    write_summary(folder)


def test_the_report_compares_methods(folder):
    for seed, (fixed, learned) in enumerate([(100.0, 110.0), (200.0, 210.0), (300.0, 250.0)]):
        save(folder, "hitl-fix", seed, fixed, boundary=0.7)
        save(folder, "hitl-ac", seed, learned)
    save(folder, "srl", 5, 0.0)
    folder.write_partial(RunKey("srl", 1), table(EPISODE_COLUMNS, 2))
    assert [p.name for p in write_summary(folder)] == ["summary.csv", "summary.md"]

    frame = pd.read_csv(folder.path / "summary.csv")
    assert tuple(frame.columns) == SUMMARY_COLUMNS
    assert frame["method"].tolist() == ["srl"] + ["hitl-fix"] * 3 + ["hitl-ac"] * 3
    assert frame["episodes_to_200"].isna().all()

    lines = (folder.path / "summary.md").read_text().splitlines()
    assert "- srl: seeds finished 1, under way 1" in lines
    assert "| measure | srl | hitl-fix | hitl-ac |" in lines
    # 27 resamples of three seeds: the least mean has probability 1/27 > 2.5 %, so the interval is
    # the range. One seed has no interval.
    assert "| autonomous test return | 0.0 | 200.0 [100.0, 300.0] | 190.0 [110.0, 250.0] |" in lines
    passage = "1 of 1 seeds; median episode 100, step 1000"
    assert any(line.startswith(f"| 100 | {passage} |") for line in lines)
    assert "| 200 | 0 of 1 seeds | 0 of 3 seeds | 0 of 3 seeds |" in lines
    # hitl-ac wins two seeds of three; srl shares no seed with the others.
    assert "| hitl-ac over hitl-fix | 0.67 [0.00, 1.00] | 3 |" in lines
    assert "| hitl-fix over srl | – | 0 |" in lines


def test_nothing_finished_is_said(folder):
    write_summary(folder)
    assert "No run has finished yet" in (folder.path / "summary.md").read_text()
    assert pd.read_csv(folder.path / "summary.csv").empty


def test_a_mark_reached_by_few_seeds_has_no_median(folder):
    save(folder, seed=0)
    for seed in (1, 2):
        save(folder, seed=seed, returns=np.zeros(120))
    write_summary(folder)
    assert "| 100 | 1 of 3 seeds |" in (folder.path / "summary.md").read_text()


def test_nan_stays_nan_in_the_measures(folder):
    save(folder)
    [run] = folder.load_all()
    run.tests["return"][0] = np.nan  # A table refuses it: no file could bring it.
    row = summarise_run(run)
    assert np.isnan(row["test_return_mean"])
    run.episodes["return"][-1] = np.nan
    row = summarise_run(run)
    assert np.isnan(row["final_return_100"])
    assert np.isnan(row["best_return_100"])


def test_test_episodes_that_were_not_finite_are_named(folder):
    save(folder, lost_tests=2)
    save(folder, seed=1)
    write_summary(folder)
    assert (
        "- hitl-ac: seeds finished 2, under way 0; test episodes with numbers that are not finite, "
        "counted as falls: seed 0 has 2\n"
    ) in (folder.path / "summary.md").read_text()
