"""Figures that cannot be drawn."""

import sys

import pytest
from example_figures import NAMES
from matplotlib.figure import Figure

from hitl_jax.analysis import alarm_figures, figures
from hitl_jax.analysis.figures import draw_all
from hitl_jax.benchmarks import scaling
from hitl_jax.commands import figures as command
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.results import atomic_files
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.studies.ablations import figure
from hitl_jax.studies.ablations.runs import runs_of, settings_of
from hitl_jax.studies.ablations.settings import ABLATIONS
from hitl_jax.studies.ablations.store import _MEASURES, Store
from hitl_jax.studies.ablations.write import write_ablation
from hitl_jax.sweep.background_figures import draw


def _fails(*_, **__):
    raise RuntimeError("there is\nno font")


def test_a_figure_that_cannot_be_drawn_costs_no_other(plain, monkeypatch, capsys):
    for path in plain.path.glob("figures/*"):
        path.unlink()
    monkeypatch.setitem(figures.DRAWINGS, "figure4_training", _fails)
    assert run_main("figures", command.main, [str(plain.path)]) == 1
    told = capsys.readouterr().out.splitlines()
    assert told[-1] == "figure4_training: could not be drawn: RuntimeError: there is no font"
    assert {path.stem for path in plain.path.glob("figures/*")} == {"figure4_steps"}
    [*_, told] = draw(plain)
    assert "figure4_training: could not be drawn" in told
    assert (plain.path / "summary.md").exists()


@pytest.mark.parametrize("error", [MemoryError("much"), ValueError("x"), OSError(2, "no font")])
def test_a_picture_that_cannot_be_made_is_told(plain, error, monkeypatch):
    real = Figure.savefig

    def savefig(figure, *arguments, **options):
        if options["format"] == "svg":
            raise error
        real(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    drawn = draw_all(plain)
    assert drawn.paths == []
    assert [line.split(":")[0] for line in drawn.failures] == ["figure4_training", "figure4_steps"]
    assert type(error).__name__ in drawn.failures[0]


def test_without_matplotlib_there_is_one_line(plain, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    [told] = draw_all(plain).failures
    assert told.startswith(", ".join(NAMES) + ": could not be drawn: ModuleNotFoundError: ")


def test_a_full_disk_is_the_folders_error(plain, monkeypatch):
    def full(descriptor, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic_files, "write_synced", full)
    with pytest.raises(ResultsError, match=r"figure4_training\.png: No space left on device"):
        draw_all(plain)


def test_the_other_drawings_cost_nothing_either(tmp_path, monkeypatch):
    """Of an ablation, of the benchmark, of alarms."""
    monkeypatch.setattr(figure, "draw_rows", _fails)
    ablation = ABLATIONS["fading"]
    store = Store(tmp_path / "runs.csv")
    setting, parts = next(settings_of(ablation))
    [run, *_] = runs_of(ablation, setting, parts)
    store.add(run, dict.fromkeys(_MEASURES, 1.0) | {"commit": "abc"})
    written = write_ablation("fading", ablation, store)
    assert written.table
    assert written.failures == ["fading: could not be drawn: RuntimeError: there is no font"]
    assert (tmp_path / "fading.md").exists()
    monkeypatch.setattr(scaling, "draw_rows", _fails)
    [told] = scaling.draw_scaling([], str(tmp_path / "scaling.svg"))
    assert "scaling.svg: could not be drawn: " in told
    monkeypatch.setattr(alarm_figures, "_figure", _fails)
    (tmp_path / alarm_figures.DATA).write_text(",".join(alarm_figures.COLUMNS) + "\n")
    [told] = alarm_figures.draw(ResultsFolder(tmp_path)).failures
    assert told == "figure8_alarms: could not be drawn: RuntimeError: there is no font"
