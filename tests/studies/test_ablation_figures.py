"""Figures over numbers: of what the human's time brings, and of ablations, from made-up runs."""

import matplotlib
import numpy as np
import pytest

from hitl_jax.analysis.figure_style import style
from hitl_jax.studies.ablations.figure import draw_curves
from hitl_jax.studies.ablations.human_time import draw_human_time, measured
from hitl_jax.studies.ablations.settings import ABLATIONS
from hitl_jax.studies.ablations.store import AREA
from hitl_jax.studies.ablations.table import Line


def _line(method, label, seconds, area):
    runs = [{"train_human_steps": 50.0 * seconds, AREA: area + seed} for seed in range(-1, 2)]
    return Line(label, method, runs)


def test_each_setting_is_a_point_at_its_means():
    fixed = [_line("hitl-fix", "0.3", 200.0, 90.0), _line("hitl-fix", "0.7", 80.0, 70.0)]
    learned = [_line("hitl-ac", "0.7 (default)", 150.0, 120.0)]
    with matplotlib.rc_context():
        figure = draw_human_time("τ_0", [fixed, learned])
    [axes], [legend] = figure.axes, figure.legends
    drawn = [np.transpose(line.get_data()).tolist() for line in axes.lines]
    assert drawn == [[[200.0, 90.0], [80.0, 70.0]], [[150.0, 120.0]]]
    assert [text.get_text() for text in axes.texts] == ["0.3", "0.7", "0.7"]
    told = [text.get_text() for text in legend.texts]
    assert told == ["HITL-FIX, by τ_0", "HITL-AC, by τ_0"]


def test_settings_of_which_a_run_lacks_its_tests_are_left_out():
    whole, partly = _line("hitl-ac", "0", 150.0, 120.0), _line("hitl-ac", "5", 100.0, 110.0)
    partly.runs[1][AREA] = None
    assert measured([whole, partly]) == [whole]


@pytest.mark.parametrize("name", [name for name, of in ABLATIONS.items() if of.is_number])
def test_the_title_of_every_ablation_of_a_number_covers_nothing(name):
    runs = [{"test_return_mean": 1.0, "train_interventions": 2.0}] * 2
    with style():
        figure = draw_curves(ABLATIONS[name].title, [Line("1", "hitl-ac", runs)])
        figure.canvas.draw()
        assert [axes.get_xlabel() for axes in figure.axes] == ["", ""]
        [title] = [text for text in figure.texts if text.get_text() == ABLATIONS[name].title]
        box = title.get_window_extent()
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
        [legend] = figure.legends
        for other in (legend, *figure.axes):
            assert not box.overlaps(other.get_window_extent())
