"""What the human's time brings: each setting's tests over the seconds in human hands."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.figure_style import COLUMN, line_mark, line_style, literal, panels
from hitl_jax.analysis.task_facts import STEPS_PER_SECOND
from hitl_jax.studies.ablations.store import AREA
from hitl_jax.studies.ablations.table import Line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STEPS = "train_human_steps"
GUIDE = "mean over seeds, bootstrap 95 % intervals"


def measured(lines: Sequence[Line]) -> list[Line]:
    """The lines that have both measures for every seed."""
    return [
        line
        for line in lines
        if all(run.get(AREA) is not None and run.get(_STEPS) is not None for run in line.runs)
    ]


def draw_human_time(values: str, curves: Sequence[Sequence[Line]]) -> Figure:
    """Points with intervals; a curve is drawn where the human's time goes one way along it.

    Args:
        values: what the lines' labels are values of.
        curves: lines of `measured`, of one method each.
    """
    figure, [axes] = panels(1, 1, (COLUMN, 4.2))
    for lines in curves:
        draw_points(axes, lines)
    axes.set(xlabel="in human hands during training [s]", ylabel="area under the tests")
    marks = [
        line_mark(marker="o", label=f"{lines[0].method.upper()}, by {literal(values)}", **style)
        for lines in curves
        for style in [line_style(lines[0].method)]
    ]
    figure.legend(handles=marks, title=GUIDE, loc="outside lower center", handlelength=3.5)
    return figure


def draw_points(
    axes: Axes, lines: Sequence[Line], steps_per_second: float = STEPS_PER_SECOND
) -> None:
    """A point for each line, with intervals, and its label.

    Args:
        axes: to draw into.
        lines: of `measured`, of one method; nothing is drawn without any.
        steps_per_second: of the task's time.
    """
    if not lines:
        return
    style = line_style(lines[0].method)
    seconds = [line.values(_STEPS) / steps_per_second for line in lines]
    areas = [line.values(AREA) for line in lines]
    xs, ys = ([values.mean() for values in measure] for measure in (seconds, areas))
    one_way = len({np.sign(step) for step in np.diff(xs)}) == 1
    axes.plot(xs, ys, marker="o", markersize=4, linewidth=1.2 if one_way else 0.0, **style)
    x_ends, y_ends = (
        np.transpose([stats.bootstrap_interval(values, stats.mean) for values in measure])
        for measure in (seconds, areas)
    )
    axes.hlines(ys, *x_ends, color=style["color"], linewidth=1.0, alpha=0.6)
    axes.vlines(xs, *y_ends, color=style["color"], linewidth=1.0, alpha=0.6)
    # On both sides in turn, since points may lie close together.
    for line, x, y, side in zip(lines, xs, ys, itertools.cycle("lr"), strict=False):
        away = {"l": (-7, "right"), "r": (7, "left")}[side]
        place: dict[str, Any] = {"xytext": (away[0], -3), "ha": away[1], "fontsize": 7.5}
        name = literal(line.label.split()[0]) if x > 0 else ""
        place |= {"bbox": {"fc": "w", "ec": "none", "pad": 0.5}, "color": style["color"]}
        axes.annotate(name, (x, y), textcoords="offset points", **place)
