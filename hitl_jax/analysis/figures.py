"""The paper's figures 4 to 6 and the human's work, drawn from saved data only.

Each figure is a PNG and an SVG in OUT/figures. Curves are interquartile means over seeds with
bootstrap 95 % bands. Where seeds have data of different lengths, each point is over those that
reach it, and the curve ends where fewer than half do.
"""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable
from typing import TYPE_CHECKING

from hitl_jax.analysis import boundary_figures, human_figure, return_figures, skill_figures
from hitl_jax.analysis.figure_data import FigureData, load
from hitl_jax.analysis.figure_style import Drawn, attempt, save
from hitl_jax.results.folder import ResultsFolder, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWINGS: dict[str, Callable[[FigureData], Figure | None]] = {
    "figure4_training": return_figures.over_episodes,
    "figure4_steps": return_figures.over_steps,
    "figure5_test": skill_figures.tests,
    "figure5_progress": skill_figures.over_training,
    "figure5_human_time": skill_figures.over_human_time,
    "figure6_boundary": boundary_figures.boundary,
    "figure6_moves": boundary_figures.moves,
    "figure7_human": human_figure.work,
}
"""By the name of the file; each gives None where there are no data for it."""


def draw_all(folder: ResultsFolder, runs: list[Run] | None = None) -> Drawn:
    """Draws every figure that the data allow, early data of unfinished runs included.

    Args:
        folder: the results.
        runs: its finished runs; None reads them.

    Raises:
        ResultsError: if the folder or a run is damaged, or a file cannot be written.
    """
    data = load(folder, runs)

    def make(name: str) -> list[pathlib.Path] | None:
        figure = DRAWINGS[name](data)
        return None if figure is None else save(figure, folder.path / "figures" / name)

    return attempt({name: functools.partial(make, name) for name in DRAWINGS})
