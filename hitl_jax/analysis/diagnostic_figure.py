"""What the learners of a sweep were at: a panel for each metric, a curve for each method."""

from __future__ import annotations

import math
import pathlib
from typing import TYPE_CHECKING

import numpy as np

from hitl_jax.analysis.curves import over_episodes
from hitl_jax.analysis.figure_style import PAGE, Drawn, attempt, draw_curve, legend, panels, save
from hitl_jax.results.diagnostic_table import COUNTERS
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import ResultsFolder, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

NAME = "figure10_diagnostics"
_COLUMNS = 3
_ROW_HEIGHT = 1.7
"""[inch]"""


def draw(folder: ResultsFolder) -> Drawn:
    """Draws the figure into the folder's `figures`.

    Raises:
        ResultsError: if a run is damaged, or a file cannot be written.
    """
    runs = [run for run in folder.load_all() if run.diagnostics]

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
            values = [_known(run, metric) for run in runs if run.key.method == method]
            if known := [series for series in values if len(series)]:
                lines[method] = draw_curve(panel, method, over_episodes(known, 1))
    for panel in axes[len(metrics) :]:
        panel.remove()
    for panel in axes[max(len(metrics) - _COLUMNS, 0) : len(metrics)]:
        panel.set_xlabel("thousands of updates")
        panel.tick_params(labelbottom=True)
    legend(figure, list(lines.values()))
    return figure


def _known(run: Run, metric: str) -> np.ndarray:
    """A metric of a run, [K]; empty where the run has it not, or never a number."""
    values = run.diagnostics.get(metric, np.empty(0))
    return values if np.isfinite(values).all() else np.empty(0)
