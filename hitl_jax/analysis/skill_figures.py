"""Figure 5: the tests, at the end of training and during it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.curves import over_samples, over_seeds
from hitl_jax.analysis.figure_data import FigureData, MethodData
from hitl_jax.analysis.figure_style import (
    COLOURS,
    COLUMN,
    GREY,
    PAGE,
    draw_curve,
    legend,
    line_mark,
    mark_solved,
    method_label,
    panels,
)
from hitl_jax.results.episode_tables import Table, select

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HELPED = (0, (6, 1.5, 1, 1.5, 1, 1.5))
"""Dashes that no method's curve has."""

_GOLDEN = 0.618033988749895
"""Multiples of it, modulo 1, spread points evenly and look irregular."""


def tests(data: FigureData) -> Figure | None:
    """Each test episode by itself, and the mean of each method with its seeds.

    The episodes of a test are independent of each other: no line joins them.
    """
    methods = [m for m in data.methods if m.tests]
    if not methods:
        return None
    figure, [left, right] = panels(1, 2, (PAGE, 3.7))
    for place, m in enumerate(methods):
        autonomous, assisted = (_returns(m.tests, mode) for mode in ("autonomous", "assisted"))
        shift = 0.17 if assisted else 0.0
        for returns, side, face in ((autonomous, -1, COLOURS[m.name]), (assisted, 1, "white")):
            if returns:
                _draw_episodes(left, place + side * shift, returns, m.name, face)
                _draw_seeds(right, place + side * shift, returns, m.name, face)
    for axes in (left, right):
        axes.set_xticks(range(len(methods)), [_tick(m) for m in methods])
        axes.set(xlim=(-0.5, len(methods) - 0.5))
        axes.grid(visible=False, axis="x")
        mark_solved(axes, "", data.solved)  # good walkers stand where the word would
    left.set(ylabel="return of each test episode of each seed")
    right.set(ylabel="mean test return of each seed (small),\nand of all seeds (large)")
    marks = [
        line_mark(color=GREY, marker="o", markerfacecolor=face, label=label, linestyle=style)
        for face, style, label in (
            (GREY, "-", "autonomous (right: with bootstrap 95 % interval of the mean)"),
            ("white", "-", "assisted by the human"),
        )
    ]
    marks.append(line_mark(color=GREY, linewidth=0.9, linestyle="--", label="solved"))
    figure.legend(handles=marks, loc="outside lower center", ncols=3)
    return figure


def over_training(data: FigureData) -> Figure | None:
    """Test returns over training, which no human's reset cuts short."""
    methods = [m for m in data.methods if len(m.progress.returns)]
    if not methods:
        return None
    figure, [axes] = panels(1, 1, (COLUMN, 3.7))
    lines = []
    for m in methods:
        curve = over_seeds(m.progress.points, list(m.progress.returns), stats.interquartile_mean)
        lines.append(draw_curve(axes, m.name, curve))
        lines[-1].set(marker="o", markersize=3)
    for m in methods:
        if len(m.assisted.returns):
            centre = stats.interquartile_mean(m.assisted.returns, 0)
            axes.plot(m.assisted.points, centre, color=COLOURS[m.name], linestyle=_HELPED)
    helped = any(len(m.assisted.returns) for m in methods)
    others = [line_mark(color=GREY, linestyle=_HELPED, label="assisted by the human")] * helped
    axes.set(xlabel="training episodes before the test")
    name = "test return" if helped else "autonomous test return"
    axes.set(ylabel=f"{name}\n(mean of {_episodes_of(methods)} episodes)")
    mark_solved(axes, "solved", data.solved)
    legend(figure, lines, others)
    return figure


def over_human_time(data: FigureData) -> Figure | None:
    """Autonomous tests during training over the time that the human has acted until then."""
    methods = [m for m in data.methods if m.human_seconds.any()]
    if not methods:
        return None
    figure, [axes] = panels(1, 1, (COLUMN, 3.7))
    lines = []
    for m in methods:
        # A walker that needed less help than another stays what it was at the end.
        ends = np.full((len(m.human_seconds), 1), m.human_seconds.max())
        places = np.append(m.human_seconds, ends, axis=1)
        returns = np.append(m.progress.returns, m.progress.returns[:, -1:], axis=1)
        curve = over_samples(list(places), list(returns))
        lines.append(draw_curve(axes, m.name, curve))
    axes.set(xlabel="time in human hands so far [s]")
    axes.set(ylabel=f"autonomous test return\n(mean of {_episodes_of(methods)} episodes)")
    mark_solved(axes, "solved", data.solved)
    legend(figure, lines)
    return figure


def _episodes_of(methods: list[MethodData]) -> str:
    """Of how many episodes tests during training are."""
    return " or ".join(map(str, sorted({m.progress.episodes for m in methods})))


def _returns(tests: list[Table], mode: str) -> list[np.ndarray]:
    """Returns of the test episodes of each seed that has some, [T_s]."""
    returns = [select(table, "mode", mode)["return"] for table in tests]
    return [values for values in returns if len(values)]


def _tick(m: MethodData) -> str:
    return method_label(m.name, len(m.tests), "no interval").replace(" (", "\n(", 1)


def _draw_episodes(
    axes: Axes, place: float, returns: list[np.ndarray], name: str, face: str
) -> None:
    """A dot for each episode, spread sideways so that they overlap less."""
    values = np.concatenate(returns)
    spread = place + 0.24 * (np.arange(len(values)) * _GOLDEN % 1.0 - 0.5)
    look: dict[str, Any] = {"color": COLOURS[name], "marker": "o", "markerfacecolor": face}
    # As a picture within the SVG: thousands of shapes make it slow to show.
    look |= {"linestyle": "", "markersize": 2.2, "markeredgewidth": 0.5, "rasterized": True}
    axes.plot(spread, values, alpha=0.6, **look)


def _draw_seeds(axes: Axes, place: float, returns: list[np.ndarray], name: str, face: str) -> None:
    """The mean return of each seed as a small dot, and their mean with its interval beside them."""
    means = np.array([values.mean() for values in returns])
    marker: dict[str, Any] = {"color": COLOURS[name], "marker": "o", "markerfacecolor": face}
    marker |= {"linestyle": ""}
    spread = place - 0.08 + 0.06 * (np.arange(len(means)) % 3 - 1) / 2  # so that dots overlap less
    axes.plot(spread, means, markersize=3, alpha=0.7, **marker)
    if len(means) > 1:
        interval = stats.bootstrap_interval(means, stats.mean)
        axes.plot([place + 0.05] * 2, interval, color=COLOURS[name], linewidth=1.4)
    axes.plot([place + 0.05], [means.mean()], markersize=7, **marker)
