"""Alarms at any boundary: counted by hand, and as the tests of a run count them."""

import types

import numpy as np
import pytest
from matplotlib.figure import Figure
from pages import ROOT

from hitl_jax.analysis import alarm_figures
from hitl_jax.analysis.alarms import count_alarms, total
from hitl_jax.commands import alarms as command
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.results.folder import ResultsFolder

_TAUS = np.array([0.0, 0.5, 2.0])


def test_a_fall_by_hand():
    size = np.array([0.6, 0.1, 0.1, 0.7, 0.1, 1.5])
    counts = count_alarms(size, fell=True, boundaries=_TAUS, window=4)
    assert (counts.steps, counts.falls) == (6, 1)
    assert counts.alarms.tolist() == [6, 3, 0]
    assert counts.timely_alarms.tolist() == [4, 2, 0]
    assert counts.warned_falls.tolist() == [1, 1, 0]
    assert counts.lead_steps.tolist() == [3, 2, 0]


def test_without_a_fall_no_alarm_is_timely():
    counts = count_alarms(np.array([0.6, 0.1]), fell=False, boundaries=_TAUS)
    assert (counts.steps, counts.falls) == (2, 0)
    assert counts.alarms.tolist() == [2, 1, 0]
    assert counts.timely_alarms.sum() == counts.warned_falls.sum() == counts.lead_steps.sum() == 0


def test_episodes_add_up():
    one = count_alarms(np.array([0.6]), fell=True, boundaries=_TAUS)
    both = total([one, one])
    assert (both.steps, both.falls) == (2, 2)
    assert both.alarms.tolist() == [2, 2, 0]


def test_the_folder_must_hold_runs(tmp_path, capsys):
    assert run_main("alarms", command.main, [str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"error: {tmp_path}: no results here (no config.json)\n"
    assert run_main("alarms", command.main, [str(tmp_path), "--episodes", "0"]) == 2
    assert "--episodes 0: must be at least 1" in capsys.readouterr().err


def test_a_damaged_table_is_one_line(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume({"agent": {}}, "command")
    (folder.path / alarm_figures.DATA).write_text("method,seed\nsrl,0\n")
    with pytest.raises(ResultsError, match=r"alarms.csv: damaged: the header is not method,seed"):
        alarm_figures.draw(folder)


def test_what_is_not_known_is_not_counted():
    told = count_alarms(np.array([0.6, 0.1]), fell=True, boundaries=np.array([0.5, np.nan]))
    for counts in (told.alarms, told.timely_alarms, told.warned_falls):
        np.testing.assert_array_equal(counts, [1.0, np.nan])
    unseen = count_alarms(np.array([0.6, np.nan]), fell=False, boundaries=_TAUS)
    assert np.isnan(unseen.alarms).all()
    assert np.isnan(total([unseen._replace(alarms=np.zeros(3)), unseen]).alarms).all()
    assert (unseen.steps, unseen.falls) == (2, 0)


def _table(folder, **counts):
    columns = dict.fromkeys(alarm_figures.COLUMNS, "0") | {"method": "hitl-fix"}
    lines = [",".join(alarm_figures.COLUMNS)]
    for boundary in ("0.2", "0.4"):
        lines.append(",".join((columns | {"boundary": boundary} | counts).values()))
    (folder.path / alarm_figures.DATA).write_text("\n".join(lines) + "\n")


def test_a_panel_without_data_is_not_drawn(tmp_path, monkeypatch):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume({"agent": {"indicator": "hull_angle"}}, "command")
    figures = []

    def keep(figure, stem):
        figure.draw_without_rendering()
        figures.append(figure)
        return [stem]

    monkeypatch.setattr(alarm_figures, "save", keep)
    many = {"steps": "100", "alarms": "50", "timely_alarms": "20"}
    for counts, panels in (
        ({"steps": "100"}, 1),
        (many, 2),
        (many | {"falls": "30", "warned_falls": "10"}, 3),
        (many | {"falls": "30", "warned_falls": "25"}, 4),
    ):
        _table(folder, **counts)
        alarm_figures.draw(folder)
        assert len(figures[-1].axes) == panels
        assert all(axes.lines for axes in figures[-1].axes)
    _table(folder, steps="5")
    assert alarm_figures.draw(folder).no_data == ["figure8_alarms: no data for it"]


def test_a_boundary_over_the_state_is_shown_by_its_mean():
    """Its last value is of one state, anywhere within the bounds."""
    axes = Figure().subplots()
    counts = {"hitl-ac": types.SimpleNamespace(seeds=range(10))}
    alarm_figures._mark_boundaries([axes], counts, ResultsFolder(ROOT / "results" / "full"))
    [band] = axes.patches
    assert 0.2 < band.get_x() < band.get_x() + band.get_width() < 0.4
