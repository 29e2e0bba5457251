"""Figure 12: what a human's help is worth, at equal human time, by who calls the human.

From RESULTS/assistance.csv. Returns and human time are averaged over seeds at each rate of alarms,
and interpolated between rates, so that rules are compared at the same share of the steps in human
hands.
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

ALONE, NOBODY = "alone", "nobody"
"""The rule of the autonomous test, and who is called."""

HUMANS = JUDGES, TRUSTS = "judges", "trusts"
"""Who is called: the run's human, who has to agree, or one who agrees with every alarm."""

COLUMNS = (
    "method",
    "seed",
    "rule",
    "human",
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

_WORDS = {"method": METHODS, "rule": (ALONE, *_LOOKS), "human": (NOBODY, *HUMANS)}
"""Columns of words, and what may stand there."""

Rows = dict[str, np.ndarray]


class Help(NamedTuple):
    """What help is worth to a method's walkers at shares of the steps in human hands.

    The first row is of all seeds, the others of resamples, which are the same for all rules;
    [1 + R, B] each, and NaN where the walkers were never so long in human hands.

    Attributes:
        gain: mean return above that of the walkers alone.
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
        for name, allowed in _WORDS.items():
            if unknown := set(cells[name]) - set(allowed):
                raise ValueError(f"{name} {min(unknown)[:50]!r}: must be one of {allowed}")
        rows = {
            name: np.array(values) if name in _WORDS else finite(name, values)
            for name, values in cells.items()
        }
        if (rows["episodes"] < 1).any() or (rows["steps"] < 1).any():
            raise ValueError("episodes and steps must be at least 1")
        _require_alone(rows)
        _require_equal(rows)
        return rows


def _require_alone(rows: Rows) -> None:
    """Raises ValueError where a run was not played alone once, or a rule called nobody."""
    runs = list(zip(rows["method"].tolist(), rows["seed"].tolist(), strict=True))
    alone = [run for run, rule in zip(runs, rows["rule"], strict=True) if rule == ALONE]
    for method, seed in dict.fromkeys(runs):
        if (times := alone.count((method, seed))) != 1:
            raise ValueError(f"{method} seed {seed:g}: played {ALONE} {times} times")
    if ((rows["rule"] == ALONE) != (rows["human"] == NOBODY)).any():
        raise ValueError(f"human {NOBODY} must stand beside rule {ALONE}, and there alone")


def _require_equal(rows: Rows) -> None:
    """Raises ValueError where runs of a method were not played with the same rules and rates."""
    played: dict[str, dict[float, list[tuple[str, str, float]]]] = {}
    names = ("method", "seed", "rule", "human", "alarm_share")
    for method, seed, *how in zip(*(rows[name].tolist() for name in names), strict=True):
        played.setdefault(method, {}).setdefault(seed, []).append(tuple(how))
    for method, runs in played.items():
        if len({tuple(sorted(run)) for run in runs.values()}) > 1:
            raise ValueError(f"{method}: its runs were not played at the same rates of alarms")


def rules_of(rows: Rows, method: str) -> list[str]:
    """The rules of a method's runs, in the order of the legend."""
    own = set(rows["rule"][rows["method"] == method].tolist())
    return [rule for rule in _LOOKS if rule in own]


def help_at(rows: Rows, method: str, rule: str, human: str, shares: np.ndarray) -> Help:
    """Interpolates the means over seeds at shares of the steps in human hands.

    Args:
        rows: of `load`.
        method: whose runs.
        rule: who calls the human.
        human: one of `HUMANS`.
        shares: of the steps, [B].
    """
    held, returns, falls = _curves(rows, method, rule, human)
    resampled = stats.resampled_seeds(len(held))
    drawn = np.concatenate([np.arange(len(held))[None], resampled])

    def at(values: np.ndarray) -> np.ndarray:
        curves = zip(held[drawn].mean(1), values[drawn].mean(1), strict=True)
        return np.array([_interpolated(shares, *curve) for curve in curves])

    return Help(at(returns - returns[:, :1]), at(falls))


def _curves(
    rows: Rows, method: str, rule: str, human: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of steps in human hands, return, and share of falls of each seed, [S, K] each.

    The first column is of the walker alone, the others of rising shares of alarms.
    """
    mine = rows["method"] == method
    points = []
    for seed in np.unique(rows["seed"][mine]):
        run = mine & (rows["seed"] == seed)
        helped = np.flatnonzero(run & (rows["rule"] == rule) & (rows["human"] == human))
        order = np.argsort(rows["alarm_share"][helped], kind="stable")
        points.append([*np.flatnonzero(run & (rows["rule"] == ALONE)), *helped[order]])
    at = np.array(points)
    held = rows["human_steps"][at] / rows["steps"][at]
    return held, rows["return_mean"][at], rows["falls"][at] / rows["episodes"][at]


def _interpolated(shares: np.ndarray, held: np.ndarray, values: np.ndarray) -> np.ndarray:
    order = np.argsort(held, kind="stable")
    told: np.ndarray = np.interp(shares, held[order], values[order], right=np.nan)
    return told


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
    teams = [(method, human) for method in methods for human in HUMANS]
    figure, axes_of = panels(2, len(teams), (PAGE, 4.6))
    above, below = axes_of[: len(teams)], axes_of[len(teams) :]
    for first, *others in (above, below):
        for other in others:
            other.sharey(first)
    lines: dict[str, Any] = {}
    for *column, (method, human) in zip(above, below, teams, strict=True):
        for rule in rules_of(rows, method):
            own = help_at(rows, method, rule, human, _GRID)
            lines[rule] = _curve(column[0], own.gain, rule)
            _curve(column[1], own.falls, rule)
        column[0].axhline(0.0, color=GREY, linewidth=0.8)
        title = f"{method.upper()}, human {human}"
        column[0].set_title(title, fontsize=9, color=COLOURS[method])
        column[1].set(xlabel="steps in human hands [share]", ylim=(0.0, None))
    above[0].set_ylabel("test return above\nthat of the walker alone")
    below[0].set_ylabel("tests that end\nin a fall [share]")
    title = "who calls the human; mean over seeds, band: bootstrap 95 %"
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": max(len(lines), 1)}
    figure.legend(handles=list(lines.values()), title=title, **place)
    return figure


def _curve(axes: Axes, values: np.ndarray, rule: str) -> Any:
    """Mean over seeds with its interval, as far as half of the resamples reach."""
    known = np.isfinite(values[0]) & (np.isfinite(values[1:]).mean(axis=0) >= 0.5)
    low, high = interval(values[:, known])
    looks = _LOOKS[rule]
    axes.fill_between(_GRID[known], low, high, color=looks["color"], alpha=0.15, linewidth=0)
    middle = values[0, known]
    return axes.plot(_GRID[known], middle, linewidth=1.4, label=literal(rule), **looks)[0]


def interval(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the interval of what `help_at` gives, or of a difference of such, [B] each.

    Resamples that were never so long in human hands are left out.
    """
    tail = 50.0 * (1.0 - stats.LEVEL)
    low, high = np.nanpercentile(values[1:], [tail, 100.0 - tail], axis=0)
    return low, high
