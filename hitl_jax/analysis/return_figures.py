"""Figure 4: the training return of each method."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hitl_jax.analysis import curves
from hitl_jax.analysis.figure_data import FigureData, MethodData
from hitl_jax.analysis.figure_style import COLUMN, draw_curve, legend, mark_solved, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def over_episodes(data: FigureData) -> Figure | None:
    """Over episodes, as in the paper."""
    drawn = [(m, curves.over_episodes(m.column("return"), data.window)) for m in data.trained]
    return _draw(data, drawn, "training episode")


def over_steps(data: FigureData) -> Figure | None:
    """Over environment steps: a human who resets early shortens episodes."""
    drawn = []
    for m in data.trained:
        steps = [counts / 1000 for counts in m.column("env_steps")]
        drawn.append((m, curves.over_steps(steps, m.column("return"), data.window)))
    return _draw(data, drawn, "environment steps [thousands]")


def _draw(
    data: FigureData, drawn: list[tuple[MethodData, curves.Curve]], x_label: str
) -> Figure | None:
    if not drawn:
        return None
    figure, [axes] = panels(1, 1, (COLUMN, 3.9))
    lines = [draw_curve(axes, m.name, curve, m.unfinished) for m, curve in drawn]
    axes.set(xlabel=x_label, ylabel=data.return_label)
    mark_solved(axes, "solved", data.solved)
    legend(figure, lines, window=data.window)
    return figure
