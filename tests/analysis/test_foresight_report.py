"""The report's section on foresight: its tables by hand, and what it says where something lacks."""

import csv

import example_results
import numpy as np
import pytest

from hitl_jax.analysis import assistance_figure, warning_figures
from hitl_jax.analysis.early_warnings import FALSE_ALARM_SHARES, RECALLS
from hitl_jax.reports.foresight import foresight
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey


def _write(path, columns, rows):
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


@pytest.fixture
def folder(tmp_path):
    made = ResultsFolder(tmp_path / "foresight_ddpg")
    config = example_results.CONFIG | {"episodes": 4}
    made.create_or_resume(config, "command")
    runs = [("hitl-ac", 0), ("hitl-ac", 1)]
    for method, seed in runs:
        info = example_results.make_info(config=config, commit="0123456789")
        episodes = example_results.make_episodes()
        tests = example_results.make_tests() | {"fall": [1, 0]}  # Autonomous, assisted.
        params = example_results.make_params()
        made.save_run(RunKey(method, seed), episodes, tests, params, info)
    helped = [
        (*run, rule, human, 0.1, 0.5, 10, returned, falls, 1000, held, 3)
        for run in runs
        for rule, human, returned, falls, held in (
            ("alone", "nobody", 100.0, 6, 0),
            ("learned boundary", "judges", 200.0, 2, 200),
            ("chance", "judges", 120.0, 6, 200),
            ("learned boundary", "trusts", 140.0, 4, 200),
            ("chance", "trusts", 60.0, 7, 200),
        )
    ]
    _write(made.path / assistance_figure.DATA, assistance_figure.COLUMNS, helped)
    warned = [
        (*run, name, share, 0.5, 1000, 10, 30, count, 900)
        for run in runs
        for name, count in (("fall_risk", 27), ("hull_angle", 9))
        for share in FALSE_ALARM_SHARES
    ]
    _write(made.path / warning_figures.WARNINGS, warning_figures.WARNING_COLUMNS, warned)
    precise = [
        (*run, name, recall, 0.5, 100, 80)
        for run in runs
        for name in ("fall_risk", "hull_angle")
        for recall in RECALLS
    ]
    _write(made.path / warning_figures.PRECISION, warning_figures.PRECISION_COLUMNS, precise)
    reliable = [
        (*run, place / 10, 10 * place + 7, 100, 10 * place) for run in runs for place in range(10)
    ]
    columns = warning_figures.RELIABILITY_COLUMNS
    _write(made.path / warning_figures.RELIABILITY, columns, reliable)
    return made


def test_the_tables_are_told(folder):
    text = foresight(folder.path.parent, pytest.fail)
    assert (
        "the mean return is -33 alone and 100 with the human, whom the boundary calls as it was "
        "learned: +133 [+133, +133] with 100.0% of the steps in human hands. 100% of the tests end "
        "in a fall alone, 0% with the human."
    ) in text
    assert "mean return of 100 and fall in 60% of their tests" in text
    assert "| judges | 5% | learned boundary | 25 [25, 25] | 0.83 | – |" in text
    assert "| judges | 15% | chance | 15 [15, 15] | 1.00 | 60 [60, 60] |" in text
    assert "| trusts | 15% | chance | -30 [-30, -30] | 1.12 | 60 [60, 60] |" in text
    assert "| fall_risk | 0.90 [0.90, 0.90] |" in text
    assert "| 0.50 | 0.80 | 0.80 |" in text
    assert "by at most 0.07" in text
    assert "figures/figure12_assistance.png" in text


def test_what_lacks_is_said(folder):
    root = folder.path.parent
    (folder.path / assistance_figure.DATA).unlink()
    text = foresight(root, pytest.fail)
    assert "Help was not measured (no assistance.csv)." in text
    assert "| fall_risk | 0.90 [0.90, 0.90] |" in text
    (folder.path / warning_figures.PRECISION).unlink()
    assert "without precision.csv so far" in foresight(root, pytest.fail)
    assert "Not run yet" in foresight(root / "nowhere", pytest.fail)


def test_without_falls_nothing_is_divided_by_them(folder):
    rows = list(csv.reader((folder.path / assistance_figure.DATA).read_text().splitlines()))
    for row in rows[1:]:
        row[rows[0].index("falls")] = "0"
    _write(folder.path / assistance_figure.DATA, rows[0], rows[1:])
    for name, columns in (
        (warning_figures.WARNINGS, warning_figures.WARNING_COLUMNS),
        (warning_figures.PRECISION, warning_figures.PRECISION_COLUMNS),
        (warning_figures.RELIABILITY, warning_figures.RELIABILITY_COLUMNS),
    ):
        _write(folder.path / name, columns, [])
    with np.errstate(all="raise"):
        text = foresight(folder.path.parent, pytest.fail)
    assert "| judges | 5% | learned boundary | 25 [25, 25] | – | – |" in text


def test_of_few_falls_no_share_is_told(folder):
    """A fall of each of two walkers: a share of them would say nothing."""
    path = folder.path / warning_figures.WARNINGS
    rows = list(csv.reader(path.read_text().splitlines()))
    for row in rows[1:]:
        row[rows[0].index("falls")], row[rows[0].index("warned_falls")] = "1", "1"
    _write(path, rows[0], rows[1:])
    text = foresight(folder.path.parent, pytest.fail)
    assert "| fall_risk | too few falls to say |" in text
    assert "nan" not in text
