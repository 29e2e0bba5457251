"""The paper's figures 4 to 6 and the human's burden, drawn from saved data only.

Each figure is a PNG and an SVG in OUT/figures. Colours keep the paper's roles (SRL red, HITL-FIX
green, HITL-AC blue) in the colour-blind-safe shades of Okabe and Ito
(https://jfly.uni-koeln.de/color/), and each method has its own line style. Curves are interquartile
means over seeds with bootstrap 95 % bands. Where seeds have data of different lengths, each point
is over those that reach it, and the curve ends where fewer than half do.
"""

import io
import pathlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hitl_jax import stats
from hitl_jax.curves import Curve, over_episodes, over_seeds, over_steps
from hitl_jax.files import write_bytes_atomic
from hitl_jax.results import ResultsFolder, flatten
from hitl_jax.summary import skill_over_training
from hitl_jax.tables import METHODS, Table, select

SOLVED = 300.0
"""The return that counts as solving BipedalWalker."""

_COLOURS = {"srl": "#D55E00", "hitl-fix": "#009E73", "hitl-ac": "#0072B2"}
_GREY = "#444444"
_DASHES: dict[str, tuple[float, ...]] = {"srl": (1.2, 1.2), "hitl-fix": (5.0, 1.6), "hitl-ac": ()}
_COLUMN, _PAGE = 4.2, 7.2  # inches; shrunk to a paper's 3.5 and 7.2, 9 point is at least 7.5
_DOTS_PER_INCH = 250
_STYLE: Any = {
    "font.size": 9.0,
    "legend.fontsize": 8.0,
    "legend.title_fontsize": 8.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "svg.hashsalt": "hitl_jax",  # the same data give the same file
}


class _Method(NamedTuple):
    """One method's data: training episodes of all runs, test episodes of the finished ones.

    `progress` has the mean test returns of the runs that were tested during training as well, and
    `points` when that was.
    """

    name: str
    training: list[Table]
    unfinished: int
    tests: list[Table]
    points: np.ndarray
    progress: list[np.ndarray]


class _Data(NamedTuple):
    """What the figures draw; `window` is the number of episodes that returns are smoothed over."""

    methods: list[_Method]
    window: int
    boundary_label: str


def paper_style() -> AbstractContextManager[None]:
    """Fonts, grid and frames of all figures, within a `with`."""
    return matplotlib.rc_context(_STYLE)


def draw_all(
    folder: ResultsFolder, rng: np.random.Generator
) -> tuple[list[pathlib.Path], list[str]]:
    """Draws every figure that the data allow, early data of unfinished runs included.

    Args:
        folder: the results.
        rng: drawn from for the bootstrap intervals.

    Returns:
        The files written, and a note for each figure that has no data yet.

    Raises:
        ResultsError: if the folder or a run is damaged, or a file cannot be written.
    """
    data = _load(folder)
    drawings: dict[str, Callable[[_Data, np.random.Generator], Figure | None]] = {
        "figure4_training": _draw_training,
        "figure4_steps": _draw_steps,
        "figure5_test": _draw_tests,
        "figure5_progress": _draw_progress,
        "figure6_boundary": _draw_boundary,
        "figure7_human": _draw_human,
    }
    paths: list[pathlib.Path] = []
    notes: list[str] = []
    with paper_style():
        for name, draw in drawings.items():
            figure = draw(data, rng)
            if figure is None:
                notes.append(f"{name}: no data for it yet")
                continue
            paths += save(figure, folder.path / "figures" / name)
    return paths, notes


def _load(folder: ResultsFolder) -> _Data:
    runs, partials = folder.load_all(), folder.load_partials()
    methods = []
    for name in METHODS:
        finished = [run for run in runs if run.key.method == name]
        begun = [t for key, t in partials.items() if key.method == name and len(t["episode"])]
        training = [run.episodes for run in finished if len(run.episodes["episode"])] + begun
        tested = [run for run in finished if (run.tests["mode"] == "autonomous").any()]
        often = [skill_over_training(run) for run in tested if len(run.progress["trained"])]
        if training or tested:
            points = often[0][0] if often else np.empty(0)
            progress = [returns for _, returns in often]
            tests = [run.tests for run in tested]
            methods.append(_Method(name, training, len(begun), tests, points, progress))
    longest = max((len(t["episode"]) for m in methods for t in m.training), default=0)
    return _Data(methods, int(np.clip(longest // 10, 20, 100)), boundary_label(folder))


def boundary_label(folder: ResultsFolder) -> str:
    """What an axis of boundaries is called: they have the unit of the folder's indicator."""
    config = flatten(folder.load_config())
    indicators = [value for key, value in config.items() if key.split(".")[-1] == "indicator"]
    in_radians = set(indicators) <= {"hull_angle"}
    return "boundary [rad]" if in_radians else f"boundary [unit of {indicators[0]}]"


def _draw_training(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 4: training return over episodes, as in the paper."""
    curves = [(m, over_episodes(_column(m, "return"), data.window, rng)) for m in _trained(data)]
    return _draw_returns(data, curves, "training episode")


def _draw_steps(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 4 over environment steps: a human who resets early shortens episodes."""
    curves = []
    for m in _trained(data):
        steps = [t["env_steps"] / 1000 for t in m.training]
        curves.append((m, over_steps(steps, _column(m, "return"), data.window, rng)))
    return _draw_returns(data, curves, "environment steps [thousands]")


def _draw_returns(data: _Data, curves: list[tuple[_Method, Curve]], x_label: str) -> Figure | None:
    if not curves:
        return None
    figure, [axes] = _panels(1, 1, (_COLUMN, 3.7))
    lines = [_draw_curve(axes, m, curve) for m, curve in curves]
    axes.set(xlabel=x_label, ylabel=_return_label(data))
    _mark_solved(axes, "solved")
    _legend(figure, lines)
    return figure


def _draw_tests(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 5: the test episodes one by one, and the mean of each method with its seeds."""
    methods = [m for m in data.methods if m.tests]
    if not methods:
        return None
    figure, [left, right] = _panels(1, 2, (_PAGE, 3.5))
    left.sharey(right)
    lines: list[Line2D] = []
    for place, m in enumerate(methods):
        autonomous = [select(t, "mode", "autonomous")["return"] for t in m.tests]
        assisted = [select(t, "mode", "assisted")["return"] for t in m.tests]
        assisted = [returns for returns in assisted if len(returns)]
        curve = over_seeds(np.arange(1, 1 + max(map(len, autonomous))), autonomous, stats.mean, rng)
        label = _label(m.name, len(autonomous), "no interval")
        lines += left.plot(curve.x, curve.centre, label=label, linewidth=1.0, **line_style(m.name))
        shift = 0.17 if assisted else 0.0
        _draw_seeds(right, place - shift, autonomous, m.name, _COLOURS[m.name], rng)
        if assisted:
            _draw_seeds(right, place + shift, assisted, m.name, "white", rng)
    left.set(xlabel="autonomous test episode", ylabel="return, mean over seeds")
    right.set_xticks(range(len(methods)), [m.name.upper() for m in methods])
    right.set(xlim=(-0.5, len(methods) - 0.5), ylabel="mean test return")
    right.grid(visible=False, axis="x")
    for axes in (left, right):
        _mark_solved(axes, "")  # good walkers stand where the word would
    marks = [
        Line2D([], [], color=_GREY, marker="o", markerfacecolor=face, label=label)
        for face, label in (
            (_GREY, "autonomous: mean over seeds, bootstrap 95 % interval; small: each seed"),
            ("white", "assisted by the human: likewise"),
        )
    ]
    lines.append(Line2D([], [], color=_GREY, linewidth=0.9, linestyle="--", label="solved"))
    figure.legend(handles=lines, loc="outside upper center", ncols=4)
    figure.legend(handles=marks, loc="outside lower center", ncols=2)
    return figure


def _draw_progress(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Skill over training: autonomous test returns, which no human's reset cuts short."""
    methods = [m for m in data.methods if m.progress]
    if not methods:
        return None
    figure, [axes] = _panels(1, 1, (_COLUMN, 3.7))
    lines = []
    for m in methods:
        curve = over_seeds(m.points, m.progress, stats.interquartile_mean, rng)
        lines.append(_draw_curve(axes, m._replace(unfinished=0), curve))
        lines[-1].set(marker="o", markersize=4)
    axes.set(xlabel="training episodes before the test", ylabel="autonomous test return")
    _mark_solved(axes, "solved")
    _legend(figure, lines)
    return figure


def _draw_boundary(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 6: the switching boundary over training, and the return below it."""
    methods = _with_human(data)
    if not methods:
        return None
    figure, [upper, lower] = _panels(2, 1, (_COLUMN, 5.2), sharex=True)
    lines: list[Line2D] = []
    seed_lines: list[Line2D] = []
    for m in methods:
        if m.name == "hitl-ac":  # the others' boundaries do not differ from seed to seed
            thin: dict[str, Any] = {"color": _COLOURS[m.name], "alpha": 0.35, "linewidth": 0.5}
            for t in m.training:
                seed_lines += upper.plot(t["episode"], t["mean_boundary"], **thin)
            seed_lines[0].set_label(f"{m.name.upper()}, each seed")
        _draw_curve(upper, m, over_episodes(_column(m, "mean_boundary"), 1, rng))
        curve = over_episodes(_column(m, "return"), data.window, rng)
        lines.append(_draw_curve(lower, m, curve))
    upper.set(ylabel=f"{data.boundary_label},\nmean of the episode")
    lower.set(xlabel="training episode", ylabel=_return_label(data))
    _mark_solved(lower, "solved")
    _legend(figure, lines + seed_lines[:1])
    return figure


def _draw_human(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 7: what the human has to do, and the return that goes with it."""
    methods = _with_human(data)
    if not methods:
        return None
    figure, [left, right] = _panels(1, 2, (_PAGE, 3.4))
    lines: list[Line2D] = []
    for m in methods:
        interventions = _column(m, "interventions")
        lines.append(_draw_curve(left, m, over_episodes(interventions, data.window, rng)))
        # Episode by episode: over interventions as such, the seeds that need few would drop out.
        total = [np.cumsum(values) for values in interventions]
        burden = over_episodes(total, 1, rng)
        returns = over_episodes(_column(m, "return"), data.window, rng)
        right.plot(burden.centre, returns.centre, linewidth=1.6, **line_style(m.name))
        ends = [stats.trailing_mean(values, data.window)[-1] for values in _column(m, "return")]
        dots: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3, "alpha": 0.6}
        right.plot([values[-1] for values in total], ends, color=_COLOURS[m.name], **dots)
    left.set(xlabel="training episode")
    left.set(ylabel=f"interventions per episode\n(mean of the last {data.window} episodes)")
    left.set_ylim(0.0, 1.05 * left.get_ylim()[1])
    right.set(ylabel=_return_label(data))
    right.set(xlabel="interventions so far\n(dot: last episode of a seed)")
    _mark_solved(right, "solved")
    _legend(figure, lines)
    return figure


def _draw_curve(axes: Axes, method: _Method, curve: Curve) -> Line2D:
    label = _label(method.name, curve.seeds, "no band", method.unfinished)
    [line] = axes.plot(curve.x, curve.centre, label=label, linewidth=1.6, **line_style(method.name))
    if curve.seeds > 1:
        colour = _COLOURS[method.name]
        axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
    return line


def _draw_seeds(
    axes: Axes,
    place: float,
    returns: list[np.ndarray],
    name: str,
    face: str,
    rng: np.random.Generator,
) -> None:
    """The mean return of each seed as a small dot, and their mean with its interval beside them."""
    means = np.array([values.mean() for values in returns])
    marker: dict[str, Any] = {"color": _COLOURS[name], "marker": "o", "markerfacecolor": face}
    marker |= {"linestyle": ""}
    spread = place - 0.08 + 0.06 * (np.arange(len(means)) % 3 - 1) / 2  # so that dots overlap less
    axes.plot(spread, means, markersize=3, alpha=0.7, **marker)
    if len(means) > 1:
        interval = stats.bootstrap_interval(means, stats.mean, rng)
        axes.plot([place + 0.05] * 2, interval, color=_COLOURS[name], linewidth=1.4)
    axes.plot([place + 0.05], [means.mean()], markersize=7, **marker)


def _trained(data: _Data) -> list[_Method]:
    return [m for m in data.methods if m.training]


def _with_human(data: _Data) -> list[_Method]:
    return [m for m in _trained(data) if m.name != "srl"]


def _column(method: _Method, name: str) -> list[np.ndarray]:
    return [t[name] for t in method.training]


def _return_label(data: _Data) -> str:
    return f"training return\n(mean of the last {data.window} episodes)"


def _label(name: str, seeds: int, without: str, unfinished: int = 0) -> str:
    label = (
        f"{name.upper()} ({seeds} seeds" if seeds > 1 else f"{name.upper()} ({without}: one seed"
    )
    return label + f", {unfinished} unfinished)" if unfinished else label + ")"


def line_style(name: str) -> dict[str, Any]:
    """Colour and dashes of a method, as matplotlib's arguments."""
    return {"color": _COLOURS[name], "linestyle": (0.0, _DASHES[name])}


def _mark_solved(axes: Axes, text: str) -> None:
    """A dashed line at 300, always in view."""
    axes.axhline(SOLVED, color=_GREY, linewidth=0.9, linestyle="--", zorder=1)
    low, high = axes.get_ylim()
    axes.set_ylim(top=max(high, SOLVED + 0.12 * (SOLVED - low)))
    place: dict[str, Any] = {"xytext": (0, 2), "textcoords": "offset points"}
    place |= {"ha": "right", "va": "bottom", "fontsize": 7.5}
    axes.annotate(text, (1.0, SOLVED), xycoords=("axes fraction", "data"), **place)


def _panels(
    rows: int, columns: int, size: tuple[float, float], sharex: bool = False
) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(rows, columns, sharex=sharex, squeeze=False).flat)


def _legend(figure: Figure, lines: list[Line2D]) -> None:
    title = "interquartile mean over seeds; band: bootstrap 95 % interval"
    figure.legend(handles=lines, title=title, loc="outside lower center")


def save(figure: Figure, stem: pathlib.Path) -> list[pathlib.Path]:
    """Writes a figure as PNG and SVG; the files written.

    Args:
        figure: drawn under `paper_style`.
        stem: the files' path without its ending.

    Raises:
        ResultsError: if a file cannot be written.
    """
    paths = []
    # Without a date in it, the same data give the same file.
    for kind, metadata in (("png", None), ("svg", {"Date": None})):
        picture = io.BytesIO()
        figure.savefig(picture, format=kind, dpi=_DOTS_PER_INCH, metadata=metadata)
        paths.append(stem.with_suffix(f".{kind}"))
        write_bytes_atomic(paths[-1], picture.getvalue())
    return paths
