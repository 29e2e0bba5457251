"""Figures from whatever is there: full results, early ones, one seed, nothing."""

import subprocess
import sys
import xml.etree.ElementTree
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
import pytest
from example_figures import CONFIG, NAMES, save
from example_training import make_training

from hitl_jax.analysis import figure_data, figures
from hitl_jax.analysis.figures import draw_all
from hitl_jax.commands import figures as command
from hitl_jax.console.cli import run_main
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey


def text_of(figure) -> str:
    legends = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    labels = [f"{axes.get_xlabel()} {axes.get_ylabel()}" for axes in figure.axes]
    return "\n".join(legends + labels)


@pytest.fixture
def drawn(monkeypatch) -> dict[str, Any]:
    """The figures by name, kept instead of written."""
    kept: dict[str, Any] = {}

    def keep(figure, stem):
        figure.draw_without_rendering()
        kept[stem.name] = figure
        return [stem]

    monkeypatch.setattr(figures, "save", keep)
    return kept


def test_full_results_give_every_figure_twice(folder):
    for method in METHODS:
        for seed in range(3):
            save(folder, method, seed)
    before = dict(matplotlib.rcParams)
    paths, notes, failures = draw_all(folder)
    assert dict(matplotlib.rcParams) == before
    assert notes == failures == []
    written = sorted(p.name for p in (folder.path / "figures").iterdir())
    assert written == sorted(f"{name}.{kind}" for name in NAMES for kind in ("png", "svg"))
    assert sorted(p.name for p in paths) == written
    for path in paths:
        if path.suffix == ".svg":
            assert xml.etree.ElementTree.parse(path).getroot().tag.endswith("svg")
        else:
            data = path.read_bytes()
            assert data.startswith(b"\x89PNG")
            # The header's width: a paper's column of 3.5 inches at 150 dots and more.
            assert int.from_bytes(data[16:20]) >= 3.5 * 150


def test_early_results_draw_what_there_is(folder, drawn):
    for seed, count in ((0, 30), (1, 12)):
        folder.write_partial(RunKey("hitl-ac", seed), make_training("hitl-ac", seed, count))
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0, 2))
    folder.write_partial(RunKey("srl", 1), make_training("srl", 1, 0))
    _, notes, _ = draw_all(folder)
    missing = ["figure5_test", "figure5_progress", "figure5_human_time"]
    assert [note.split(":")[0] for note in notes] == missing
    text = text_of(drawn["figure4_training"])
    assert "HITL-AC (2 seeds, 1 at the end, 2 unfinished)" in text
    assert "SRL (no band: one seed, 1 unfinished)" in text
    assert "(mean of the last 20 episodes)" in text
    lines = drawn["figure4_training"].axes[0].get_lines()
    # Two seeds of episodes 1 to 30 and 1 to 12: half of them reach the end.
    assert lines[1].get_xdata()[-1] == 30
    # A bar stands at the last episode that both have.
    assert (lines[1].get_marker(), lines[1].get_markevery()) == ("|", [11])
    [title] = [of.get_title().get_text() for of in drawn["figure4_training"].legends]
    assert "right of the bar on a curve: over the seeds that got so far" in title
    assert "before episode 20: means of the episodes so far" in title
    assert lines[0].get_color() == "#D55E00"
    assert "SRL" not in text_of(drawn["figure6_boundary"])


def test_one_finished_run_of_one_method(folder, drawn):
    save(folder, "srl", 0, modes=("autonomous",))
    _, notes, _ = draw_all(folder)
    without_human = {"figure5_human_time", "figure6_boundary", "figure6_moves", "figure7_human"}
    assert {note.split(":")[0] for note in notes} == without_human
    for axes in drawn["figure5_test"].axes:
        assert [tick.get_text() for tick in axes.get_xticklabels()] == [
            "SRL\n(no interval: one seed)"
        ]


@pytest.mark.parametrize("modes", [(), ("assisted",)])
def test_runs_without_autonomous_tests_skip_figure_5(folder, drawn, modes):
    save(folder, "hitl-ac", 0, modes=modes)
    _, notes, _ = draw_all(folder)
    missing = ["figure5_test", "figure5_progress", "figure5_human_time"]
    assert [note.split(":")[0] for note in notes] == missing


def test_figure_5_shows_the_means_of_the_tests(folder, drawn):
    save(folder, "hitl-ac", 0)
    draw_all(folder)
    left, right = drawn["figure5_test"].axes
    for dots, returns in zip(left.get_lines(), (200.0, 250.0), strict=False):
        np.testing.assert_array_equal(dots.get_ydata(), returns + 10.0 * np.arange(5))
        assert dots.get_linestyle() == "None"  # Test episodes are independent of each other.
    heights = [line.get_ydata()[0] for line in right.get_lines()[:4]]
    # Autonomous 200 … 240, assisted 250 … 290: the seed's dot, then the mean over the one seed.
    assert heights == [220.0, 220.0, 270.0, 270.0]


def test_what_moved_the_boundary_adds_up(tmp_path, drawn):
    folder = ResultsFolder(tmp_path / "residual")
    agent = {"indicator": "hull_angle", "boundary_source": "residual"}
    hyper = {"initial_boundary": 0.6, "delta_minus": 0.01, "delta_plus": 0.02}
    folder.create_or_resume({"agent": agent, "hyper": hyper}, "command")
    training = make_training("hitl-ac", 0, 5)
    training |= {"true_alarms": np.arange(5), "false_alarms": np.array([0, 2, 0, 0, 1])}
    folder.write_partial(RunKey("hitl-ac", 0), training)
    draw_all(folder)
    whole, down, up, rest = (line.get_ydata() for line in drawn["figure6_moves"].axes[0].lines)
    np.testing.assert_allclose(whole, 0.1)  # from 0.6 to the 0.7 of every episode
    np.testing.assert_allclose(down, [0.0, -0.01, -0.03, -0.06, -0.1])
    np.testing.assert_allclose(up, [0.0, 0.04, 0.04, 0.04, 0.06])
    np.testing.assert_allclose(whole, down + up + rest)


def _with_threshold(tmp_path, danger):
    folder = ResultsFolder(tmp_path / danger)
    agent = CONFIG["agent"] | {"danger": danger}
    hyper = CONFIG["hyper"] | {"human": {"tolerance": 0.45}}
    folder.create_or_resume(CONFIG | {"agent": agent, "hyper": hyper}, "command")
    folder.write_partial(RunKey("hitl-ac", 0), make_training("hitl-ac", 0))
    return folder


def test_figure_6_has_the_humans_threshold(tmp_path, drawn):
    draw_all(_with_threshold(tmp_path, "threshold"))
    upper = drawn["figure6_boundary"].axes[0]
    assert any(list(line.get_ydata()) == [0.45, 0.45] for line in upper.get_lines())
    assert "the human's threshold, 0.45 rad" in text_of(drawn["figure6_boundary"])
    draw_all(_with_threshold(tmp_path, "lookahead"))
    assert "threshold" not in text_of(drawn["figure6_boundary"])


def test_the_solved_line_is_always_in_view(folder, drawn):
    folder.write_partial(RunKey("hitl-fix", 0), make_training("hitl-fix", 0, 3))
    draw_all(folder)
    for name in ("figure4_training", "figure4_steps", "figure6_boundary", "figure7_human"):
        low, high = drawn[name].axes[-1].get_ylim()
        assert low < -90.0
        assert high > 300.0


def test_another_indicator_is_not_called_radians(tmp_path, drawn):
    folder = ResultsFolder(tmp_path / "other")
    folder.create_or_resume({"agent": {"indicator": "hull_velocity"}}, "command")
    folder.write_partial(RunKey("hitl-ac", 0), make_training("hitl-ac", 0, 3))
    draw_all(folder)
    assert "boundary [unit of hull_velocity]" in text_of(drawn["figure6_boundary"])


def test_the_same_data_give_the_same_files(folder):
    folder.write_partial(RunKey("hitl-ac", 0), make_training("hitl-ac", 0, 5))
    first, second = ([p.read_bytes() for p in draw_all(folder).paths] for _ in range(2))
    assert first == second


def test_command_prints_the_files(folder, capsys):
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0, 5))
    assert run_main("figures", command.main, [str(folder.path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert str(folder.path / "figures/figure4_training.png") in lines
    assert "figure5_test: no data for it" in lines


def test_command_refuses_in_one_line(folder, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for path, says in (
        (tmp_path / "nowhere", "no results here (no config.json)"),
        (tmp_path / "empty", "no results here (no config.json)"),
        (folder.path, "no episode has been saved yet"),
    ):
        assert run_main("figures", command.main, [str(path)]) == 2
        captured = capsys.readouterr()
        assert captured.err == f"error: {path}: {says}\n"
        assert captured.out == ""


def test_command_runs_as_a_module(folder):
    arguments = [sys.executable, "-m", "hitl_jax", "figures", str(folder.path)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == f"error: {folder.path}: no episode has been saved yet\n"


def test_a_diverged_run_counts_in_returns_and_nowhere_else(folder):
    for seed in range(3):
        save(folder, "hitl-ac", seed)
    save(folder, "hitl-ac", 3, diverged=10)
    save(folder, "hitl-fix", 0, diverged=0)
    [fixed, learned] = figure_data.load(folder).methods
    assert [len(t["episode"]) for t in learned.training] == [40] * 4
    assert [len(t["episode"]) for t in learned.played] == [40, 40, 40, 10]
    assert len(fixed.training) == 1
    assert fixed.played == []
    paths, notes, failures = draw_all(folder)
    assert notes == failures == []
    assert len(paths) == 2 * len(NAMES)


def test_over_human_time_a_walker_stays_what_it_was_at_the_end(folder, drawn):
    """One that took less help than another does not leave the mean."""
    for seed in range(3):
        save(folder, "hitl-fix", seed)
    draw_all(folder)
    line = drawn["figure5_human_time"].axes[0].get_lines()[-2]  # The last marks what is solved.
    [method] = figure_data.load(folder).methods
    ends = [table["human_steps"].sum() / 50 for table in method.training]
    assert len(set(ends)) > 1
    assert line.get_xdata()[-1] == max(ends)
    assert "at the end" not in text_of(drawn["figure5_human_time"])
