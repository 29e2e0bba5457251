"""Figure 11: how early each indicator warns of falls, how precisely, and whether the risk is true.

From RESULTS/early_warnings.csv, precision.csv and reliability.csv, of all seeds of a method
together.
"""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.early_warnings import (
    EARLY,
    PRECISION_COUNTS,
    RELIABILITY_COUNTS,
    WARNING_COUNTS,
)
from hitl_jax.analysis.figure_style import (
    COLOURS,
    GREY,
    PAGE,
    Drawn,
    attempt,
    line_style,
    literal,
    panels,
    save,
)
from hitl_jax.analysis.task_facts import steps_per_second_of
from hitl_jax.results.atomic_files import named_errors, read_bytes
from hitl_jax.results.episode_measures import ALARM_WINDOW
from hitl_jax.results.episode_tables import METHODS, cells_from_csv, finite
from hitl_jax.results.folder import ResultsFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WARNINGS, RELIABILITY, PRECISION = "early_warnings.csv", "reliability.csv", "precision.csv"
"""In a results folder."""

LEARNED = "learned_boundary"
"""Beside the indicators: |c_t| − π_θ(s_t), where π_θ is executed."""

TABLES = (WARNINGS, RELIABILITY, PRECISION)

_NAME = "figure11_early_warnings"
_RUN = ("method", "seed")
WARNING_COLUMNS = (*_RUN, "indicator", "false_alarm_share", "boundary", *WARNING_COUNTS)
PRECISION_COLUMNS = (*_RUN, "indicator", "recall", "boundary", *PRECISION_COUNTS)
RELIABILITY_COLUMNS = (*_RUN, "bin", "risk_sum", *RELIABILITY_COUNTS)

_LOOKS: tuple[dict[str, Any], ...] = (
    {"color": "black", "marker": "o"},
    {"color": "#CC79A7", "marker": "s", "linestyle": "--"},
    {"color": "#E69F00", "marker": "^", "linestyle": ":"},
    {"color": "#56B4E9", "marker": "v", "linestyle": "-."},
    {"color": "#999999", "marker": "D", "linestyle": "--"},
)
"""Of indicators, in the order of the file; none is a method's colour."""

_LEARNED_LOOKS: dict[str, Any] = {"color": "#882255", "marker": "x", "linestyle": "-"}
"""Of the learned boundary, in every folder."""

_FEW = 20
"""Steps of a bin, or falls, below which a share says nothing."""

Rows = dict[str, np.ndarray]


def draw(folder: ResultsFolder) -> Drawn:
    """Draws the figure into the folder's `figures`.

    Raises:
        ResultsError: if the data are damaged.
    """
    warnings, precision, reliability = load_all(folder)

    def make() -> list[pathlib.Path] | None:
        rate = steps_per_second_of(folder.load_config())
        figure = _figure(warnings, precision, reliability, rate)
        return None if figure is None else save(figure, folder.path / "figures" / _NAME)

    return attempt({_NAME: make})


def load_all(folder: ResultsFolder) -> tuple[Rows, Rows, Rows]:
    """The folder's tables of early warnings, precision and reliability.

    The second is empty in a folder of an earlier commit, which had none.

    Raises:
        ResultsError: if one is damaged.
    """
    return (
        _load(folder.path / WARNINGS, WARNING_COLUMNS),
        _load(folder.path / PRECISION, PRECISION_COLUMNS)
        if (folder.path / PRECISION).exists()
        else {name: np.array([]) for name in PRECISION_COLUMNS},
        _load(folder.path / RELIABILITY, RELIABILITY_COLUMNS),
    )


def _load(path: pathlib.Path, columns: tuple[str, ...]) -> Rows:
    """A table, numbers as float64 and words as they are, [K] by column.

    Raises:
        ResultsError: if it is damaged.
    """
    with named_errors(path):
        cells = cells_from_csv(read_bytes(path).decode(), columns)
        if unknown := set(cells["method"]) - set(METHODS):
            raise ValueError(f"method {min(unknown)[:50]!r}: must be one of {', '.join(METHODS)}")
        return {
            name: np.array(values) if name in ("method", "indicator") else finite(name, values)
            for name, values in cells.items()
        }


def pooled_share(rows: Rows, part: str, whole: str, by: str) -> tuple[np.ndarray, ...]:
    """A share over all seeds together, with a bootstrap interval over seeds.

    Args:
        rows: of one method (and indicator).
        part: a column of counts.
        whole: another.
        by: the column along which it is told.

    Returns:
        The values of `by`, the share, and the ends of its interval, [K] each; NaN where there are
        too few to say.
    """
    seeds, places = np.unique(rows["seed"]), np.unique(rows[by])
    parts, wholes = np.zeros((2, len(seeds), len(places)))
    at = np.searchsorted(seeds, rows["seed"]), np.searchsorted(places, rows[by])
    np.add.at(parts, at, rows[part])
    np.add.at(wholes, at, rows[whole])
    drawn = stats.resampled_seeds(len(seeds))
    share, low, high = np.full((3, len(places)), np.nan)
    for place in np.flatnonzero(wholes.sum(0) >= _FEW):
        part_of, whole_of = parts[:, place], wholes[:, place]
        share[place] = part_of.sum() / whole_of.sum()
        some = whole_of[drawn].sum(1) > 0
        resampled = part_of[drawn].sum(1)[some] / whole_of[drawn].sum(1)[some]
        low[place], high[place] = np.quantile(resampled, [0.025, 0.975])
    return places, share, low, high


def only(rows: Rows, **wanted: str) -> Rows:
    """The rows in which these columns hold these words."""
    chosen = np.ones(len(rows["method"]), bool)
    for name, value in wanted.items():
        chosen &= rows[name] == value
    return {name: values[chosen] for name, values in rows.items()}


def _looks_of(names: list[str]) -> dict[str, dict[str, Any]]:
    """By name; the learned boundary comes last."""
    looks = dict(zip((name for name in names if name != LEARNED), _LOOKS, strict=False))
    return looks | ({LEARNED: _LEARNED_LOOKS} if LEARNED in names else {})


def _figure(warnings: Rows, precision: Rows, reliability: Rows, rate: float) -> Figure | None:
    """None where no indicator has enough falls."""
    methods = [method for method in METHODS if _enough_falls(only(warnings, method=method))]
    if not methods:
        return None
    tells_risk = bool(reliability["steps"].sum())
    columns = len(methods) + tells_risk
    figure, axes_of = panels(2, columns, (PAGE, 5.4))
    above, below = axes_of[:columns], axes_of[columns:]
    looks_of = _looks_of(list(dict.fromkeys(warnings["indicator"].tolist())))
    window = f"{ALARM_WINDOW / rate:g} s"
    lines = {}
    for warned, precise, method in zip(above, below, methods, strict=False):
        for name, looks in looks_of.items():
            own = only(warnings, method=method, indicator=name)
            if len(own["seed"]):
                lines[name] = _draw(warned, own, _WARNED, looks, name)
                own = only(precision, method=method, indicator=name)
                _draw(precise, own, _TIMELY, looks, name)
        warned.set(xscale="log", ylim=(0.0, 1.03), xlabel="false alarms\n[share of quiet steps]")
        warned.set_title(method.upper(), fontsize=9, color=COLOURS[method])
        precise.set(
            ylim=(0.0, 1.03), xlabel=f"steps within {window} of a fall\nthat have an alarm [share]"
        )
    early = f"{EARLY / rate:g} s"
    above[0].set_ylabel(f"falls warned of\nat least {early} before [share]")
    below[0].set_ylabel(f"alarms within {window}\nof a fall [share]")
    if tells_risk:
        _draw_reliability(above[-1], reliability)
        below[-1].set_axis_off()
    title = "all seeds together; band and bars: bootstrap 95 % interval over seeds"
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": min(len(lines), 3)}
    figure.legend(handles=list(lines.values()), title=title, **place)
    return figure


def _enough_falls(rows: Rows) -> bool:
    known: np.ndarray = rows["false_alarm_share"] == rows["false_alarm_share"].max(initial=0.0)
    own = rows["indicator"] == rows["indicator"][:1]
    return bool(rows["falls"][known & own].sum() >= _FEW)


_WARNED = ("warned_falls", "falls", "false_alarm_share")
_TIMELY = ("timely_alarms", "alarms", "recall")
"""Part, whole and what it is told along, of `pooled_share`."""


def _draw(
    axes: Axes, rows: Rows, share_of: tuple[str, str, str], looks: dict[str, Any], name: str
) -> Any:
    x, share, low, high = pooled_share(rows, *share_of)
    axes.fill_between(x, low, high, color=looks["color"], alpha=0.15, linewidth=0)
    label = literal(name.replace("_", " "))
    return axes.plot(x, share, markersize=3.5, linewidth=1.4, label=label, **looks)[0]


def _draw_reliability(axes: Axes, rows: Rows) -> None:
    """What came against what was foretold; methods in their colours."""
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=0.9, linestyle="--")
    axes.fill_between([0, 1], [-0.1, 0.9], [0.1, 1.1], color=GREY, alpha=0.08, linewidth=0)
    for method in METHODS:
        own = only(rows, method=method)
        if not own["steps"].sum():
            continue
        _, foretold, _, _ = pooled_share(own, "risk_sum", "steps", "bin")
        _, came, low, high = pooled_share(own, "falls_follow", "steps", "bin")
        bars = np.maximum([came - low, high - came], 0.0)
        looks = line_style(method)
        axes.errorbar(foretold, came, bars, marker="o", markersize=3.5, linewidth=1.2, **looks)
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="foretold risk", ylabel="falls that followed [share]")
    axes.set_title("is the risk true?", fontsize=9)
