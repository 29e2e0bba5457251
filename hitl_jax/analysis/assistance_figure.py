"""Figure 12: what a human's help is worth, at equal human time, by who calls the human.

From RESULTS/assistance.csv. Each run's return is interpolated between its rates of alarms, so that
rules are compared at the same share of the steps in human hands; then seeds are averaged.
"""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.figure_style import (
    COLOURS,
    GREY,
    PAGE,
    Drawn,
    attempt,
    literal,
    panels,
    save,
)
from hitl_jax.results.atomic_files import named_errors, read_bytes
from hitl_jax.results.episode_tables import METHODS, cells_from_csv, finite
from hitl_jax.results.folder import ResultsFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DATA = "assistance.csv"
"""In a results folder."""

ALONE = "alone"
"""The rule of the autonomous test."""

COLUMNS = (
    "method",
    "seed",
    "rule",
    "alarm_share",
    "constant",
    "episodes",
    "return_mean",
    "falls",
    "steps",
    "human_steps",
    "interventions",
)

BUDGETS = (0.05, 0.15)
"""Shares of the steps in human hands of which the report tells."""

_NAME = "figure12_assistance"
_GRID = np.linspace(0.0, 0.3, 31)
_LOOKS: dict[str, dict[str, Any]] = {
    "learned boundary": {"color": COLOURS["hitl-ac"], "linestyle": "-"},
    "fixed boundary": {"color": "#009E73", "linestyle": "--"},
    "hull angle": {"color": "#E69F00", "linestyle": "-."},
    "chance": {"color": GREY, "linestyle": ":"},
}

Rows = dict[str, np.ndarray]


class Help(NamedTuple):
    """What help is worth to a method's walkers at equal human time, [S, B] each.

    Attributes:
        gain: return above that of the walker alone.
        falls: share of the episodes that end in a fall.
    """

    gain: np.ndarray
    falls: np.ndarray


def load(path: pathlib.Path) -> Rows:
    """The table, numbers as float64 and words as they are, [K] by column.

    Raises:
        ResultsError: if it is damaged.
    """
    with named_errors(path):
        cells = cells_from_csv(read_bytes(path).decode(), COLUMNS)
        for name, allowed in (("method", METHODS), ("rule", (ALONE, *_LOOKS))):
            if unknown := set(cells[name]) - set(allowed):
                raise ValueError(f"{name} {min(unknown)[:50]!r}: must be one of {allowed}")
        rows = {
            name: np.array(values) if name in ("method", "rule") else finite(name, values)
            for name, values in cells.items()
        }
        if (rows["episodes"] < 1).any() or (rows["steps"] < 1).any():
            raise ValueError("episodes and steps must be at least 1")
        _require_alone(rows)
        return rows


def _require_alone(rows: Rows) -> None:
    """Raises ValueError where a run was not played alone once."""
    runs = list(zip(rows["method"].tolist(), rows["seed"].tolist(), strict=True))
    alone = [run for run, rule in zip(runs, rows["rule"], strict=True) if rule == ALONE]
    for method, seed in dict.fromkeys(runs):
        if (times := alone.count((method, seed))) != 1:
            raise ValueError(f"{method} seed {seed:g}: played {ALONE} {times} times")


def rules_of(rows: Rows, method: str) -> list[str]:
    """The rules of a method's runs, in the order of the legend."""
    own = set(rows["rule"][rows["method"] == method].tolist())
    return [rule for rule in _LOOKS if rule in own]


def help_at(rows: Rows, method: str, rule: str, shares: np.ndarray) -> Help:
    """Interpolates each run at shares of the steps in human hands; NaN beyond what was played.

    Args:
        rows: of `load`.
        method: whose runs.
        rule: who calls the human.
        shares: of the steps, [B].
    """
    gains: list[np.ndarray] = []
    falls: list[np.ndarray] = []
    mine = rows["method"] == method
    for seed in np.unique(rows["seed"][mine]):
        run = mine & (rows["seed"] == seed)
        [alone] = np.flatnonzero(run & (rows["rule"] == ALONE))
        points = np.append(alone, np.flatnonzero(run & (rows["rule"] == rule)))
        human = rows["human_steps"][points] / rows["steps"][points]
        human[0] = 0.0
        order = np.argsort(human, kind="stable")
        fell = rows["falls"][points] / rows["episodes"][points]
        for column, into in ((rows["return_mean"][points], gains), (fell, falls)):
            into.append(np.interp(shares, human[order], column[order], right=np.nan))
        gains[-1] = gains[-1] - rows["return_mean"][alone]
    return Help(np.array(gains), np.array(falls))


def draw(folder: ResultsFolder) -> Drawn:
    """Draws the figure into the folder's `figures`.

    Raises:
        ResultsError: if the data are damaged.
    """
    rows = load(folder.path / DATA)

    def make() -> list[pathlib.Path] | None:
        figure = _figure(rows)
        return None if figure is None else save(figure, folder.path / "figures" / _NAME)

    return attempt({_NAME: make})


def _figure(rows: Rows) -> Figure | None:
    methods = [method for method in METHODS if (rows["method"] == method).any()]
    if not methods:
        return None
    figure, axes_of = panels(2, len(methods), (PAGE, 4.6))
    above, below = axes_of[: len(methods)], axes_of[len(methods) :]
    lines: dict[str, Any] = {}
    for *column, method in zip(above, below, methods, strict=True):
        for rule in rules_of(rows, method):
            own = help_at(rows, method, rule, _GRID)
            lines[rule] = _curve(column[0], own.gain, rule)
            _curve(column[1], own.falls, rule)
        column[0].axhline(0.0, color=GREY, linewidth=0.8)
        column[0].set_title(method.upper(), fontsize=9, color=COLOURS[method])
        column[1].set(xlabel="steps in human hands [share]", ylim=(0.0, None))
    above[0].set_ylabel("test return above\nthat of the walker alone")
    below[0].set_ylabel("tests that end\nin a fall [share]")
    title = "who calls the human; mean over seeds, band: bootstrap 95 %"
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": max(len(lines), 1)}
    figure.legend(handles=list(lines.values()), title=title, **place)
    return figure


def _curve(axes: Axes, values: np.ndarray, rule: str) -> Any:
    """Mean over seeds, as far as all of them reach."""
    known = np.isfinite(values).all(axis=0)
    middle = values[:, known].mean(axis=0)
    low, high = stats.bootstrap_interval(values[:, known], stats.mean)
    looks = _LOOKS[rule]
    axes.fill_between(_GRID[known], low, high, color=looks["color"], alpha=0.15, linewidth=0)
    return axes.plot(_GRID[known], middle, linewidth=1.4, label=literal(rule), **looks)[0]
