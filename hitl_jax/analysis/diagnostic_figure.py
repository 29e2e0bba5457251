"""What the learners of a sweep were at: a panel for each metric, a curve for each method."""

from __future__ import annotations

import math
import pathlib
from typing import TYPE_CHECKING

import numpy as np

from hitl_jax.analysis.curves import over_samples
from hitl_jax.analysis.figure_style import PAGE, Drawn, attempt, draw_curve, legend, panels, save
from hitl_jax.results.diagnostic_table import COUNTERS
from hitl_jax.results.episode_tables import METHODS, Table
from hitl_jax.results.folder import ResultsFolder, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

NAME = "figure10_diagnostics"
_COLUMNS = 3
_ROW_HEIGHT = 1.7
"""[inch]"""
_UNIT = 1000.0
"""Updates that the x axis counts as one."""


def draw(folder: ResultsFolder) -> Drawn:
    """Draws the figure into the folder's `figures`.

    Raises:
        ResultsError: if a run is damaged, or a file cannot be written.
    """
    runs = [run for run in folder.load_all() if len(run.diagnostics.get("updates", ()))]

    def make() -> list[pathlib.Path] | None:
        return save(_figure(runs), folder.path / "figures" / NAME) if runs else None

    return attempt({NAME: make})


def _figure(runs: list[Run]) -> Figure:
    metrics = sorted({name for run in runs for name in run.diagnostics} - set(COUNTERS))
    rows = math.ceil(len(metrics) / _COLUMNS)
    figure, axes = panels(rows, _COLUMNS, (PAGE, rows * _ROW_HEIGHT + 1.0), sharex=True)
    lines: dict[str, Line2D] = {}
    for metric, panel in zip(metrics, axes, strict=False):
        panel.set_title(metric.replace("_", " "), fontsize=8)
        for method in METHODS:
            known = [
                run.diagnostics
                for run in runs
                if run.key.method == method and _is_known(run.diagnostics, metric)
            ]
            if known:
                thousands = [table["updates"] / _UNIT for table in known]
                curve = over_samples(thousands, [table[metric] for table in known])
                lines[method] = draw_curve(panel, method, curve)
    for panel in axes[len(metrics) :]:
        panel.remove()
    for panel in axes[max(len(metrics) - _COLUMNS, 0) : len(metrics)]:
        panel.set_xlabel("thousands of updates")
        panel.tick_params(labelbottom=True)
    legend(figure, list(lines.values()))
    return figure


def _is_known(table: Table, metric: str) -> bool:
    """Whether a run has a metric, and at least once as a number."""
    return metric in table and bool(np.isfinite(table[metric]).any())
