"""Figure 8: what alarms would have told at each boundary, from RESULTS/alarms.csv."""

import csv
import io
import pathlib
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hitl_jax import stats
from hitl_jax.figure_parts import line_style, paper_style, save
from hitl_jax.figures import boundary_label
from hitl_jax.files import named_errors
from hitl_jax.results import ResultsFolder
from hitl_jax.summary import STEPS_PER_SECOND
from hitl_jax.tables import METHODS

DATA = "alarms.csv"
"""In a results folder."""

_COUNTS = ("steps", "alarms", "timely_alarms", "falls", "warned_falls", "lead_steps")
_RESAMPLES = 1000
_SIZE = (7.2, 5.0)  # inches
_FEW = 20
"""Alarmed steps, or falls, below which a share says nothing."""

Counts = dict[str, np.ndarray]
"""Each of `_COUNTS` as [S, M]: seeds, boundaries."""


def draw(folder: ResultsFolder) -> list[pathlib.Path]:
    """Draws the figure into the folder's `figures`; the files written.

    Raises:
        ResultsError: if the data or the runs are damaged.
    """
    path = folder.path / DATA
    with named_errors(path):
        boundaries, methods = _load(path.read_text())
    with paper_style():
        return save(
            _figure(boundaries, methods, folder), folder.path / "figures" / "figure8_alarms"
        )


def _load(text: str) -> tuple[np.ndarray, dict[str, Counts]]:
    rows = list(csv.DictReader(io.StringIO(text)))
    boundaries = np.array(sorted({float(row["boundary"]) for row in rows}))
    methods = {}
    for method in METHODS:
        own = [row for row in rows if row["method"] == method]
        if own:
            shape = (-1, len(boundaries))
            methods[method] = {
                name: np.array([float(row[name]) for row in own]).reshape(shape) for name in _COUNTS
            }
    return boundaries, methods


def _figure(boundaries: np.ndarray, methods: dict[str, Counts], folder: ResultsFolder) -> Figure:
    figure = Figure(figsize=_SIZE, layout="constrained")
    panels = list(figure.subplots(2, 2, sharex=True).flat)
    shares = (
        ("alarms", "steps", "steps with an alarm [share]"),
        ("timely_alarms", "alarms", "alarms with a fall\nwithin 1 s [share]"),
        ("warned_falls", "falls", "falls with an alarm\nin the last 1 s [share]"),
        ("lead_steps", "warned_falls", "from first alarm to fall [s]"),
    )
    rng = np.random.default_rng(stats.SEED)
    for axes, (part, whole, label) in zip(panels, shares, strict=True):
        scale = 1.0 / STEPS_PER_SECOND if part == "lead_steps" else 1.0
        for method, counts in methods.items():
            _draw_share(axes, boundaries, counts[part] * scale, counts[whole], method, rng)
        axes.set(ylabel=label)
        axes.set_ylim(bottom=0.0)
    panels[0].set(yscale="log", ylim=(1e-5, 1.5))
    for axes in panels[2:]:
        axes.set(xlabel=boundary_label(folder))
    marks = [
        Line2D([], [], label=method.upper(), linewidth=1.6, **line_style(method))
        for method in methods
    ]
    marks += _mark_boundaries(panels, folder)
    title = "all seeds together; band: bootstrap 95 % interval over seeds"
    figure.legend(handles=marks, title=title, loc="outside lower center", ncols=3)
    return figure


def _draw_share(
    axes: Axes,
    x: np.ndarray,
    part: np.ndarray,
    whole: np.ndarray,
    method: str,
    rng: np.random.Generator,
) -> None:
    """Sum over seeds of `part` over that of `whole`, [S, M], where there are enough to say."""
    enough = whole.sum(0) >= _FEW
    if not enough.any():
        return
    x, part, whole = x[enough], part[:, enough], whole[:, enough]
    style = line_style(method)
    axes.plot(x, part.sum(0) / whole.sum(0), linewidth=1.6, **style)
    drawn = rng.integers(len(part), size=(_RESAMPLES, len(part)))
    parts, wholes = part[drawn].sum(1), whole[drawn].sum(1)
    ratio = np.where(wholes > 0, parts / np.maximum(wholes, 1.0), np.nan)
    low, high = np.nanquantile(ratio, [0.025, 0.975], axis=0)
    axes.fill_between(x, low, high, color=style["color"], alpha=0.18, linewidth=0)


def _mark_boundaries(panels: list[Axes], folder: ResultsFolder) -> list[Any]:
    """The human's own threshold, and where HITL-AC's boundaries ended; what the legend says."""
    tolerance = folder.load_config()["hyper"]["human"]["tolerance"]
    ends = [
        run.episodes["final_boundary"][-1]
        for run in folder.load_all()
        if run.key.method == "hitl-ac"
    ]
    threshold: dict[str, Any] = {"color": "#444444", "linewidth": 0.9, "linestyle": "--"}
    band: dict[str, Any] = {"color": line_style("hitl-ac")["color"], "alpha": 0.3}
    for axes in panels:
        axes.axvline(tolerance, **threshold)
        if ends:
            axes.axvspan(min(ends), max(ends), linewidth=0, **band)
    marks: list[Any] = [Line2D([], [], label="the human's tolerance", **threshold)]
    if ends:
        marks.append(Patch(label="learned boundaries (HITL-AC, all seeds)", linewidth=0, **band))
    return marks
