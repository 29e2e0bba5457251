"""An ablation as a figure: what each setting's seeds got, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.figure_style import PAGE, line_mark, line_style, literal, panels
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.studies.ablations.table import Line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = (
    ("test_return_mean", "autonomous test return"),
    ("train_interventions", "interventions in training"),
)
_LINE_HEIGHT, _MARGIN = 0.24, 1.5  # inches
_GUIDE = "mean over seeds, bootstrap 95 % interval; small: each seed"


def draw_curves(title: str, lines: list[Line]) -> Figure:
    """Measures over a number: curves of the mean over seeds, with bands, and the seeds as dots.

    Args:
        title: what the number is, with its unit.
        lines: whose labels begin with the number.
    """
    figure, axes_of = panels(1, len(_PANELS), (PAGE, 3.4))
    for axes, (measure, name) in zip(axes_of, _PANELS, strict=True):
        for method in METHODS:
            own = [line for line in lines if line.method == method]
            points = [(float(line.label.split()[0]), line.values(measure)) for line in own]
            points = [(x, values) for x, values in points if values.size]
            if points:
                _draw_curve(axes, points, method)
        axes.set(ylabel=name)
    figure.suptitle(literal(title), fontsize=9.0)
    _legend(figure, lines)
    return figure


def _draw_curve(axes: Axes, points: list[tuple[float, np.ndarray]], method: str) -> None:
    style = line_style(method)
    xs = [x for x, _ in points]
    axes.plot(xs, [values.mean() for _, values in points], marker="o", markersize=5, **style)
    ends = [stats.bootstrap_interval(values, stats.mean) for _, values in points]
    low, high = zip(*ends, strict=True)
    axes.fill_between(xs, low, high, color=style["color"], alpha=0.18, linewidth=0)
    for x, values in points:
        dots: dict[str, Any] = {"linestyle": "", "marker": "o", "color": style["color"]}
        axes.plot(np.full(values.size, x), values, markersize=2.5, alpha=0.5, **dots)


def draw_rows(title: str, lines: list[Line]) -> Figure:
    """A row for each setting. Small dots: seeds; large: their mean, with its interval.

    Args:
        title: of the ablation.
        lines: from the top down.
    """
    labels = list(dict.fromkeys(line.label for line in lines))
    methods = [method for method in METHODS if any(line.method == method for line in lines)]
    height = _MARGIN + _LINE_HEIGHT * len(labels) * (1 + 0.6 * (len(methods) - 1))
    figure, axes_of = panels(1, len(_PANELS), (PAGE, height))
    axes_of[1].sharey(axes_of[0])
    for axes, (measure, name) in zip(axes_of, _PANELS, strict=True):
        for line in lines:
            shift = 0.7 * ((methods.index(line.method) + 0.5) / len(methods) - 0.5)
            _draw_line(axes, labels.index(line.label) + shift, line, measure)
        axes.set(xlabel=name)
        axes.grid(visible=False, axis="y")
    axes_of[0].set(ylim=(len(labels) - 0.5, -0.5))
    axes_of[0].set_yticks(range(len(labels)), [literal(label) for label in labels])
    axes_of[1].tick_params(labelleft=False)
    figure.suptitle(literal(title), fontsize=9.0)
    _legend(figure, lines)
    return figure


def _draw_line(axes: Axes, place: float, line: Line, measure: str) -> None:
    values = line.values(measure)
    if not values.size:
        return
    colour = line_style(line.method)["color"]
    dots: dict[str, Any] = {"linestyle": "", "marker": "o", "color": colour}
    axes.plot(values, np.full(values.size, place), markersize=2.5, alpha=0.5, **dots)
    if values.size > 1:
        interval = stats.bootstrap_interval(values, stats.mean)
        axes.plot(interval, [place] * 2, color=colour, linewidth=1.4)
    axes.plot([values.mean()], [place], markersize=6, **dots)


def _legend(figure: Figure, lines: list[Line]) -> None:
    marks = [
        line_mark(marker="o", label=method.upper(), **line_style(method))
        for method in METHODS
        if any(line.method == method for line in lines)
    ]
    figure.legend(
        handles=marks, title=_GUIDE, loc="outside lower center", ncols=3, handlelength=3.5
    )
