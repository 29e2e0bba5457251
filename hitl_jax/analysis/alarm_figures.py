"""Figure 8: what alarms would have told at each boundary, from RESULTS/alarms.csv."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.claims_on_training import mean_boundary
from hitl_jax.analysis.figure_data import boundary_label, tolerance_in
from hitl_jax.analysis.figure_style import (
    PAGE,
    Drawn,
    attempt,
    line_mark,
    line_style,
    method_label,
    panels,
    patch_mark,
    save,
    threshold_line,
)
from hitl_jax.analysis.task_facts import steps_per_second_of
from hitl_jax.results.atomic_files import named_errors, read_bytes
from hitl_jax.results.episode_measures import ALARM_WINDOW
from hitl_jax.results.episode_tables import METHODS, cells_from_csv, finite
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAME = "figure8_alarms"
DATA = "alarms.csv"
"""In a results folder."""

_COUNTS = ("steps", "alarms", "timely_alarms", "falls", "warned_falls", "lead_steps")
COLUMNS = ("method", "seed", "boundary", *_COUNTS)
"""Of the file: counts of a run's test at a boundary."""

_FEW = 20
"""Alarmed steps, or falls, below which a share says nothing."""


class _Counts(NamedTuple):
    """One method: its seeds S, boundaries [M], and each of `_COUNTS` as [S, M]."""

    seeds: list[int]
    boundaries: np.ndarray
    counts: dict[str, np.ndarray]


def draw(folder: ResultsFolder) -> Drawn:
    """Draws the figure into the folder's `figures`.

    Raises:
        ResultsError: if the data or the runs are damaged.
    """
    path = folder.path / DATA
    with named_errors(path):
        methods = load_counts(read_bytes(path).decode())

    def make() -> list[pathlib.Path] | None:
        figure = _figure(methods, folder)
        return None if figure is None else save(figure, folder.path / "figures" / _NAME)

    return attempt({_NAME: make})


def load_counts(text: str) -> dict[str, _Counts]:
    """The counts of each method.

    Raises:
        ValueError: one line, if they are not of runs and boundaries, each once.
    """
    cells = cells_from_csv(text, COLUMNS)
    if unknown := set(cells["method"]) - set(METHODS):
        raise ValueError(f"method {min(unknown)[:50]!r}: must be one of {', '.join(METHODS)}")
    numbers = {name: finite(name, cells[name], name in _COUNTS) for name in COLUMNS[1:]}
    for name in ("seed", *_COUNTS):
        known = numbers[name][~np.isnan(numbers[name])]
        if (known < 0).any() or (known != np.floor(known)).any():
            raise ValueError(f"column {name!r}: must be whole numbers of at least 0")
    methods = {}
    for method in METHODS:
        own = np.array(cells["method"]) == method
        if own.any():
            methods[method] = _of_method({name: values[own] for name, values in numbers.items()})
    return methods


def _of_method(numbers: dict[str, np.ndarray]) -> _Counts:
    seeds, counts = np.unique(numbers["seed"], return_counts=True)
    by_seed = {name: values.reshape(len(seeds), -1) for name, values in numbers.items()}
    boundaries = by_seed["boundary"]
    if len(set(counts)) > 1 or (by_seed["seed"] != seeds[:, None]).any():
        raise ValueError(
            "column 'seed': must have as many boundaries for each, one after the other"
        )
    if (boundaries != boundaries[0]).any() or (np.diff(boundaries[0]) <= 0).any():
        raise ValueError("column 'boundary': must rise, alike for each seed")
    return _Counts(
        [int(seed) for seed in seeds], boundaries[0], {name: by_seed[name] for name in _COUNTS}
    )


class _Share(NamedTuple):
    """A panel: the sum over seeds of one count over that of another."""

    part: str
    whole: str
    label: str


def _shares(steps_per_second: float) -> tuple[_Share, ...]:
    window = f"{ALARM_WINDOW / steps_per_second:g} s"
    return (
        _Share("alarms", "steps", "steps with an alarm [share]"),
        _Share("timely_alarms", "alarms", f"alarms with a fall\nwithin {window} [share]"),
        _Share("warned_falls", "falls", f"falls with an alarm\nin the last {window} [share]"),
        _Share("lead_steps", "warned_falls", "from first alarm to fall [s]"),
    )


def _figure(methods: dict[str, _Counts], folder: ResultsFolder) -> Figure | None:
    """None where no share has enough counts."""
    rate = steps_per_second_of(folder.load_config())
    shares = [
        share
        for share in _shares(rate)
        if any(_enough(of.counts[share.whole]).any() for of in methods.values())
    ]
    if not shares:
        return None
    columns = min(len(shares), 2)
    rows = -(-len(shares) // columns)
    figure, axes_of = panels(rows, columns, (PAGE * columns / 2, 1.2 + 2.0 * rows))
    for spare in axes_of[len(shares) :]:
        spare.remove()
    axes_of = axes_of[: len(shares)]
    for axes, (part, whole, label) in zip(axes_of, shares, strict=True):
        scale = 1.0 / rate if part == "lead_steps" else 1.0
        for method, (_, boundaries, counts) in methods.items():
            _draw_share(axes, boundaries, counts[part] * scale, counts[whole], method)
        axes.set(xlabel=boundary_label(folder), ylabel=label)
        axes.set_ylim(bottom=0.0)
        if part == "alarms":
            axes.set(yscale="log", ylim=(1e-5, 1.5))
    marks = [
        line_mark(
            label=method_label(method, len(of.seeds), "no band"),
            linewidth=1.6,
            **line_style(method),
        )
        for method, of in methods.items()
    ]
    marks += _mark_boundaries(axes_of, methods, folder)
    title = (
        "all seeds together; band: bootstrap 95 % interval over seeds\n"
        f"drawn where a share is of at least {_FEW} steps, alarms or falls"
    )
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": 3 if columns > 1 else 1}
    figure.legend(handles=marks, title=title, **place).get_title().set_multialignment("center")
    return figure


def _enough(whole: np.ndarray) -> np.ndarray:
    """Where a share of a count [S, M] says something, bool [M]."""
    return whole.sum(0) >= _FEW


def _draw_share(
    axes: Axes, x: np.ndarray, part: np.ndarray, whole: np.ndarray, method: str
) -> None:
    """Sum over seeds of `part` over that of `whole`, [S, M], where there are enough to say."""
    enough = _enough(whole)
    if not enough.any():
        return
    x, part, whole = x[enough], part[:, enough], whole[:, enough]
    style = line_style(method)
    axes.plot(x, part.sum(0) / whole.sum(0), linewidth=1.6, **style)
    drawn = stats.resampled_seeds(len(part))
    parts, wholes = part[drawn].sum(1), whole[drawn].sum(1)
    ratio = np.where(wholes > 0, parts / np.maximum(wholes, 1.0), np.nan)
    low, high = np.nanquantile(ratio, [0.025, 0.975], axis=0)
    axes.fill_between(x, low, high, color=style["color"], alpha=0.18, linewidth=0)


def _mark_boundaries(
    axes_of: list[Axes], methods: dict[str, _Counts], folder: ResultsFolder
) -> list[Any]:
    """The human's own threshold, and where HITL-AC's boundaries ended; what the legend says.

    A boundary that is a function of the state ends at a mean: its last value is of one state.
    """
    marks: list[Any] = []
    tolerance = tolerance_in(folder)
    if tolerance is not None:
        threshold = threshold_line(tolerance)
        marks.append(line_mark(**threshold))
        for axes in axes_of:
            axes.axvline(tolerance, **threshold)
    if "hitl-ac" in methods:
        keys = [RunKey("hitl-ac", seed) for seed in methods["hitl-ac"].seeds]
        means = np.array([mean_boundary(folder.load_run(key)) for key in keys])
        ends = means[~np.isnan(means)]
        if not ends.size:
            return marks
        band: dict[str, Any] = {"color": line_style("hitl-ac")["color"], "alpha": 0.3}
        marks.append(patch_mark(label="mean learned boundaries (HITL-AC)", linewidth=0, **band))
        for axes in axes_of:
            # With a width, since equal ends make a line.
            axes.axvspan(ends.min(), ends.max(), linewidth=1.5, **band)
    return marks
