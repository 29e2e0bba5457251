"""An ablation as a figure: what each setting's seeds got, side by side."""

import pathlib
from typing import Any

import matplotlib
import numpy as np
from matplotlib.lines import Line2D

from experiments.ablations.table import Line
from hitl_jax import figure_parts, stats
from hitl_jax.figure_parts import line_style, paper_style
from hitl_jax.tables import METHODS

_PANELS = (
    ("test_return_mean", "autonomous test return"),
    ("train_interventions", "interventions in training"),
)
_WIDTH, _LINE_HEIGHT, _MARGIN = 7.2, 0.24, 1.5  # inches


def draw(title: str, lines: list[Line], rng: np.random.Generator) -> matplotlib.figure.Figure:
    """Small dots: seeds; large: their mean, with its bootstrap 95 % interval.

    Args:
        title: of the ablation.
        lines: from the top down.
        rng: drawn from for the intervals.
    """
    labels = list(dict.fromkeys(line.label for line in lines))
    methods = [method for method in METHODS if any(line.method == method for line in lines)]
    figure = matplotlib.figure.Figure(
        figsize=(_WIDTH, _MARGIN + _LINE_HEIGHT * len(labels) * (1 + 0.6 * (len(methods) - 1))),
        layout="constrained",
    )
    panels = figure.subplots(1, len(_PANELS), sharey=True)
    for axes, (measure, name) in zip(panels, _PANELS, strict=True):
        for line in lines:
            shift = 0.7 * ((methods.index(line.method) + 0.5) / len(methods) - 0.5)
            _draw_line(axes, labels.index(line.label) + shift, line, measure, rng)
        axes.set(xlabel=name)
        axes.grid(visible=False, axis="y")
    panels[0].set(ylim=(len(labels) - 0.5, -0.5))
    panels[0].set_yticks(range(len(labels)), labels)
    figure.suptitle(title, fontsize=9.0)
    marks = [
        Line2D([], [], marker="o", label=method.upper(), **line_style(method)) for method in methods
    ]
    guide = "mean over seeds, bootstrap 95 % interval; small: each seed"
    figure.legend(handles=marks, title=guide, loc="outside lower center", ncols=3)
    return figure


def _draw_line(axes: Any, place: float, line: Line, measure: str, rng: np.random.Generator) -> None:
    values = line.values(measure)
    if not values.size:
        return
    colour = line_style(line.method)["color"]
    dots: dict[str, Any] = {"linestyle": "", "marker": "o", "color": colour}
    axes.plot(values, np.full(values.size, place), markersize=2.5, alpha=0.5, **dots)
    if values.size > 1:
        interval = stats.bootstrap_interval(values, stats.mean, rng)
        axes.plot(interval, [place] * 2, color=colour, linewidth=1.4)
    axes.plot([values.mean()], [place], markersize=6, **dots)


def save(title: str, lines: list[Line], stem: pathlib.Path, rng: np.random.Generator) -> None:
    """Writes the figure as PNG and SVG."""
    with paper_style():
        figure_parts.save(draw(title, lines, rng), stem)
