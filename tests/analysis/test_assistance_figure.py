"""Figure 12: help at equal human time by hand, a drawing, and what a damaged table says."""

import csv

import numpy as np
import pytest

from hitl_jax.analysis import assistance_figure
from hitl_jax.analysis.assistance_figure import (
    ALONE,
    COLUMNS,
    DATA,
    help_at,
    interval,
    load,
    rules_of,
)
from hitl_jax.errors import ResultsError
from hitl_jax.results.folder import ResultsFolder


def _row(seed, rule, share, returned, falls, held, human="judges"):
    return ("hitl-ac", seed, rule, human, share, 0.5, 10, returned, falls, 1000, held, 3)


@pytest.fixture
def folder(tmp_path):
    made = ResultsFolder(tmp_path / "out")
    made.create_or_resume({"agent": {}}, "command")
    rows = []
    for seed in (0, 1):
        rows += [
            _row(seed, ALONE, 0.0, 100.0 + seed, 6, 0, "nobody"),
            _row(seed, "learned boundary", 0.2, 200.0 + seed, 2, 200),
            _row(seed, "learned boundary", 0.1, 150.0 + seed, 4, 100),
            _row(seed, "chance", 0.2, 120.0 + 20 * seed, 6, 200),
            _row(seed, "chance", 0.2, 111.0 + seed, 6, 100, "trusts"),
        ]
    _write(made, rows)
    return made


def _write(folder, rows):
    with (folder.path / DATA).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])


def test_returns_are_compared_at_equal_human_time(folder):
    rows = load(folder.path / DATA)
    assert rules_of(rows, "hitl-ac") == ["learned boundary", "chance"]
    shares = np.array([0.0, 0.05, 0.2, 0.25])
    told = help_at(rows, "hitl-ac", "learned boundary", "judges", shares)
    np.testing.assert_allclose(told.gain, [[0.0, 25.0, 100.0, np.nan]] * len(told.gain))
    np.testing.assert_allclose(told.falls, [[0.6, 0.5, 0.2, np.nan]] * len(told.gain))
    trusted = help_at(rows, "hitl-ac", "chance", "trusts", shares)
    np.testing.assert_allclose(trusted.gain[0], [0.0, 5.5, np.nan, np.nan])
    luck = help_at(rows, "hitl-ac", "chance", "judges", shares)
    np.testing.assert_allclose(luck.gain[0], [0.0, 7.375, 29.5, np.nan])
    low, high = interval((told.gain - luck.gain)[:, :3])  # The seeds' own are 80 and 61.
    np.testing.assert_allclose((low[2], high[2]), (61.0, 80.0))


def test_it_is_drawn(folder):
    drawn = assistance_figure.draw(folder)
    assert [path.name for path in drawn.paths] == [
        "figure12_assistance.png",
        "figure12_assistance.svg",
    ]
    _write(folder, [])
    assert assistance_figure.draw(folder).no_data == ["figure12_assistance: no data for it"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda text: text.replace("rule", "rules"), "the header is not"),
        (lambda text: text.replace("hitl-ac", "hitl-xx", 1), "method 'hitl-xx'"),
        (lambda text: text.replace("chance", "luck"), "rule 'luck'"),
        (lambda text: text.replace("trusts", "obeys"), "human 'obeys'"),
        (lambda text: text.replace("1000", "0", 1), "steps must be at least 1"),
        (lambda text: text.replace("alone", "chance"), "hitl-ac seed 0: played alone 0 times"),
        (lambda text: text.replace("chance,judges", "chance,nobody", 1), "human nobody must stand"),
        (lambda text: text.replace("alone,nobody", "alone,judges", 1), "human nobody must stand"),
        (lambda text: text.replace("120.0", "many"), "return_mean"),
        (lambda text: text.replace("0.1,", "0.3,", 1), "hitl-ac: its runs were not played at the"),
    ],
)
def test_a_damaged_table_is_one_line(folder, damage, said):
    path = folder.path / DATA
    path.write_text(damage(path.read_text()))
    with pytest.raises(ResultsError, match=rf"assistance.csv: damaged: .*{said}"):
        assistance_figure.draw(folder)
