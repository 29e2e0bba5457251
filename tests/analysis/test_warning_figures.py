"""Figure 11: shares over all seeds by hand, a drawing, and what a damaged table says."""

import csv

import numpy as np
import pytest

from hitl_jax.analysis import warning_figures
from hitl_jax.analysis.early_warnings import FALSE_ALARM_SHARES, RECALLS
from hitl_jax.analysis.warning_figures import pooled_share
from hitl_jax.errors import ResultsError
from hitl_jax.results.folder import ResultsFolder


def test_a_share_is_over_all_seeds_together_where_there_are_enough():
    rows = {
        "seed": np.array([0.0, 0.0, 1.0, 1.0]),
        "bin": np.array([0.0, 0.5, 0.0, 0.5]),
        "part": np.array([1.0, 1.0, 5.0, 1.0]),
        "whole": np.array([10.0, 1.0, 20.0, 1.0]),
    }
    places, share, low, high = pooled_share(rows, "part", "whole", "bin")
    assert places.tolist() == [0.0, 0.5]
    np.testing.assert_allclose(share, [0.2, np.nan])
    assert low[0] == pytest.approx(0.1) and high[0] == pytest.approx(0.25)
    assert np.isnan(low[1]) and np.isnan(high[1])


def test_the_learned_boundary_looks_the_same_whatever_is_beside_it():
    few = warning_figures._looks_of(["learned_boundary", "hull_angle"])
    many = warning_figures._looks_of([*"abcde", "learned_boundary"])
    assert few["learned_boundary"] == many["learned_boundary"]
    assert len({looks["color"] for looks in many.values()}) == 6


def _write(path, columns, rows):
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([columns, *rows])


@pytest.fixture
def folder(tmp_path):
    made = ResultsFolder(tmp_path / "out")
    made.create_or_resume({"agent": {}}, "command")
    warnings = [
        ("hitl-ac", seed, name, share, 0.5, 1000, int(1000 * share), 30, warned, 900)
        for seed in range(3)
        for name, warned in (("fall_risk", 28), ("hull_angle", 9), ("learned_boundary", 20))
        for share in FALSE_ALARM_SHARES
    ]
    reliability = [
        ("hitl-ac", seed, place / 10, 10.0 * (place + 0.5), 100, 10 * place + seed)
        for seed in range(3)
        for place in range(10)
    ]
    _write_all(made, warnings, reliability)
    return made


def _write_all(folder, warnings, reliability):
    precise = [
        (*row[:3], recall, 0.5, 100, 90 - 10 * place)
        for row in warnings
        for place, recall in enumerate(RECALLS)
        if row[3] == FALSE_ALARM_SHARES[0]
    ]
    _write(folder.path / warning_figures.PRECISION, warning_figures.PRECISION_COLUMNS, precise)
    _write(folder.path / warning_figures.WARNINGS, warning_figures.WARNING_COLUMNS, warnings)
    columns = warning_figures.RELIABILITY_COLUMNS
    _write(folder.path / warning_figures.RELIABILITY, columns, reliability)


def test_it_is_drawn(folder):
    drawn = warning_figures.draw(folder)
    assert [path.name for path in drawn.paths] == [
        "figure11_early_warnings.png",
        "figure11_early_warnings.svg",
    ]
    assert not drawn.failures


def test_without_falls_there_is_nothing_to_draw(folder):
    _write_all(folder, [], [])
    assert warning_figures.draw(folder).no_data == ["figure11_early_warnings: no data for it"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda text: text.replace("indicator", "indicators"), "the header is not"),
        (lambda text: text.replace("hitl-ac", "hitl-xx", 1), "method 'hitl-xx'"),
        (lambda text: text.replace("1000", "many", 1), "quiet_steps"),
        (lambda text: text[:-20], "cells"),
    ],
)
def test_a_damaged_table_is_one_line(folder, damage, said):
    path = folder.path / warning_figures.WARNINGS
    path.write_text(damage(path.read_text()))
    with pytest.raises(ResultsError, match=rf"early_warnings.csv: damaged: .*{said}"):
        warning_figures.draw(folder)
