"""The figure of what the human's time brings, from made-up runs."""

import matplotlib
import numpy as np

from hitl_jax.studies.ablations.human_time import draw_human_time, measured
from hitl_jax.studies.ablations.store import AREA
from hitl_jax.studies.ablations.table import Line


def _line(method, label, seconds, area):
    runs = [{"train_human_steps": 50.0 * seconds, AREA: area + seed} for seed in range(-1, 2)]
    return Line(label, method, runs)


def test_each_setting_is_a_point_at_its_means():
    fixed = [_line("hitl-fix", "0.3", 200.0, 90.0), _line("hitl-fix", "0.7", 80.0, 70.0)]
    learned = [_line("hitl-ac", "0 (default)", 150.0, 120.0)]
    with matplotlib.rc_context():
        [axes] = draw_human_time({"by τ_0": fixed, "by the price": learned}).axes
    drawn = [np.transpose(line.get_data()).tolist() for line in axes.lines]
    assert drawn == [[[200.0, 90.0], [80.0, 70.0]], [[150.0, 120.0]]]
    assert [text.get_text() for text in axes.texts] == ["0.3", "0.7", "0"]


def test_settings_of_which_a_run_lacks_its_tests_are_left_out():
    whole, partly = _line("hitl-ac", "0", 150.0, 120.0), _line("hitl-ac", "5", 100.0, 110.0)
    partly.runs[1][AREA] = None
    assert measured([whole, partly]) == [whole]
