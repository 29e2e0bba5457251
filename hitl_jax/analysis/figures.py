"""The paper's figures 4 to 6 and the human's burden, drawn from saved data only.

Each figure is a PNG and an SVG in OUT/figures. Curves are interquartile means over seeds with
bootstrap 95 % bands. Where seeds have data of different lengths, each point is over those that
reach it, and the curve ends where fewer than half do.
"""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.curves import Curve, over_episodes, over_seeds, over_steps
from hitl_jax.analysis.figure_style import (
    COLOURS,
    COLUMN,
    GREY,
    PAGE,
    Drawn,
    attempt,
    draw_band,
    draw_curve,
    legend,
    line_mark,
    line_style,
    literal,
    mark_solved,
    method_label,
    panels,
    save,
)
from hitl_jax.analysis.summary import skill_over_training
from hitl_jax.results.config_diff import flatten
from hitl_jax.results.episode_tables import METHODS, Table, select
from hitl_jax.results.folder import ResultsFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


class _Method(NamedTuple):
    """One method's data: training episodes of all runs, test episodes of the finished ones.

    `played` leaves out the episodes that a diverged run could not play, which count as falls in
    `training`. `progress` has the mean test returns of the runs that were tested during training
    as well, and `points` when that was.
    """

    name: str
    training: list[Table]
    played: list[Table]
    unfinished: int
    tests: list[Table]
    points: np.ndarray
    progress: list[np.ndarray]


class _Moves(NamedTuple):
    """The Δ rule where it is executed: τ_0, Δ⁻, Δ⁺, and whether an actor's output is added."""

    initial: float
    minus: float
    plus: float
    has_actor: bool


class _Data(NamedTuple):
    """What the figures draw; `window` is the number of episodes that returns are smoothed over."""

    methods: list[_Method]
    window: int
    boundary_label: str
    moves: _Moves | None


def draw_all(folder: ResultsFolder, rng: np.random.Generator) -> Drawn:
    """Draws every figure that the data allow, early data of unfinished runs included.

    Args:
        folder: the results.
        rng: drawn from for the bootstrap intervals.

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
        "figure6_moves": _draw_moves,
        "figure7_human": _draw_human,
    }

    def make(name: str) -> list[pathlib.Path] | None:
        figure = drawings[name](data, rng)
        return None if figure is None else save(figure, folder.path / "figures" / name)

    return attempt({name: functools.partial(make, name) for name in drawings})


def _load(folder: ResultsFolder) -> _Data:
    runs, partials = folder.load_all(), folder.load_partials()
    methods = []
    for name in METHODS:
        finished = [run for run in runs if run.key.method == name]
        begun = [t for key, t in partials.items() if key.method == name and len(t["episode"])]
        training = [run.episodes for run in finished if len(run.episodes["episode"])] + begun
        played = [run.played for run in finished if len(run.played["episode"])] + begun
        tested = [run for run in finished if (run.tests["mode"] == "autonomous").any()]
        often = [skill_over_training(run) for run in tested if len(run.progress["trained"])]
        if training or tested:
            points = often[0][0] if often else np.empty(0)
            # All runs of a folder have the same points.
            progress = [returns for _, returns in often]
            tests = [run.tests for run in tested]
            methods.append(_Method(name, training, played, len(begun), tests, points, progress))
    longest = max((len(t["episode"]) for m in methods for t in m.training), default=0)
    window = int(np.clip(longest // 10, 20, 100))
    return _Data(methods, window, boundary_label(folder), _moves(folder.load_config()))


def _moves(config: dict[str, Any]) -> _Moves | None:
    source = config.get("agent", {}).get("boundary_source")
    numbers = config.get("hyper", {})
    initial, minus, plus = (
        numbers.get(name) for name in ("initial_boundary", "delta_minus", "delta_plus")
    )
    if source not in ("rule", "residual") or None in (initial, minus, plus):
        return None
    return _Moves(initial, minus, plus, source == "residual")


def boundary_label(folder: ResultsFolder) -> str:
    """What an axis of boundaries is called: they have the unit of the folder's indicator."""
    config = flatten(folder.load_config())
    indicators = [value for key, value in config.items() if key.split(".")[-1] == "indicator"]
    in_radians = set(indicators) <= {"hull_angle"}
    return "boundary [rad]" if in_radians else literal(f"boundary [unit of {indicators[0]}]")


def tolerance_in(folder: ResultsFolder) -> float | None:
    """The human's own threshold, where it is one for the folder's indicator, the hull angle."""
    config = flatten(folder.load_config())
    if (config.get("agent.indicator"), config.get("agent.danger")) != ("hull_angle", "threshold"):
        return None
    return config.get("hyper.human.tolerance")


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
    figure, [axes] = panels(1, 1, (COLUMN, 3.7))
    lines = [draw_curve(axes, m.name, curve, m.unfinished) for m, curve in curves]
    axes.set(xlabel=x_label, ylabel=_return_label(data))
    mark_solved(axes, "solved")
    legend(figure, lines)
    return figure


def _draw_tests(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 5: the test episodes one by one, and the mean of each method with its seeds."""
    methods = [m for m in data.methods if m.tests]
    if not methods:
        return None
    figure, [left, right] = panels(1, 2, (PAGE, 3.5))
    left.sharey(right)
    lines: list[Line2D] = []
    for place, m in enumerate(methods):
        autonomous = [select(t, "mode", "autonomous")["return"] for t in m.tests]
        assisted = [select(t, "mode", "assisted")["return"] for t in m.tests]
        assisted = [returns for returns in assisted if len(returns)]
        curve = over_seeds(np.arange(1, 1 + max(map(len, autonomous))), autonomous, stats.mean, rng)
        label = method_label(m.name, len(autonomous), "no interval")
        lines += left.plot(curve.x, curve.centre, label=label, linewidth=1.0, **line_style(m.name))
        shift = 0.17 if assisted else 0.0
        _draw_seeds(right, place - shift, autonomous, m.name, COLOURS[m.name], rng)
        if assisted:
            _draw_seeds(right, place + shift, assisted, m.name, "white", rng)
    left.set(xlabel="autonomous test episode", ylabel="return, mean over seeds")
    right.set_xticks(range(len(methods)), [m.name.upper() for m in methods])
    right.set(xlim=(-0.5, len(methods) - 0.5), ylabel="mean test return")
    right.grid(visible=False, axis="x")
    for axes in (left, right):
        mark_solved(axes, "")  # good walkers stand where the word would
    marks = [
        line_mark(color=GREY, marker="o", markerfacecolor=face, label=label)
        for face, label in (
            (GREY, "autonomous: mean over seeds, bootstrap 95 % interval; small: each seed"),
            ("white", "assisted by the human: likewise"),
        )
    ]
    lines.append(line_mark(color=GREY, linewidth=0.9, linestyle="--", label="solved"))
    figure.legend(handles=lines, loc="outside upper center", ncols=4)
    figure.legend(handles=marks, loc="outside lower center", ncols=2)
    return figure


def _draw_progress(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Skill over training: autonomous test returns, which no human's reset cuts short."""
    methods = [m for m in data.methods if m.progress]
    if not methods:
        return None
    figure, [axes] = panels(1, 1, (COLUMN, 3.7))
    lines = []
    for m in methods:
        curve = over_seeds(m.points, m.progress, stats.interquartile_mean, rng)
        lines.append(draw_curve(axes, m.name, curve))
        lines[-1].set(marker="o", markersize=4)
    axes.set(xlabel="training episodes before the test", ylabel="autonomous test return")
    mark_solved(axes, "solved")
    legend(figure, lines)
    return figure


def _draw_boundary(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 6: the switching boundary over training, and the return below it."""
    methods = _with_human(data)
    if not methods:
        return None
    figure, [upper, lower] = panels(2, 1, (COLUMN, 5.2), sharex=True)
    lines: list[Line2D] = []
    seed_lines: list[Line2D] = []
    for m in methods:
        if m.name == "hitl-ac":  # the others' boundaries do not differ from seed to seed
            thin: dict[str, Any] = {"color": COLOURS[m.name], "alpha": 0.35, "linewidth": 0.5}
            for t in m.played:
                seed_lines += upper.plot(t["episode"], t["mean_boundary"], **thin)
            seed_lines[0].set_label(f"{m.name.upper()}, each seed")
        draw_curve(upper, m.name, over_episodes([t["mean_boundary"] for t in m.played], 1, rng))
        curve = over_episodes(_column(m, "return"), data.window, rng)
        lines.append(draw_curve(lower, m.name, curve, m.unfinished))
    upper.set(ylabel=f"{data.boundary_label},\nmean of the episode")
    lower.set(xlabel="training episode", ylabel=_return_label(data))
    mark_solved(lower, "solved")
    legend(figure, lines + seed_lines[:1])
    return figure


def _draw_moves(data: _Data, rng: np.random.Generator) -> Figure | None:
    """What moved HITL-AC's boundary from τ_0: alarms, by line 8, or the actor."""
    methods = [m for m in _with_human(data) if m.name == "hitl-ac"]
    if not methods or data.moves is None:
        return None
    [m] = methods
    rule = data.moves
    moved = [t["final_boundary"] - rule.initial for t in m.played]
    down = [-rule.minus * np.cumsum(t["true_alarms"]) for t in m.played]
    up = [rule.plus * np.cumsum(t["false_alarms"]) for t in m.played]
    parts: dict[str, tuple[str, tuple[float, ...], list[np.ndarray]]] = {
        "true alarms (Δ⁻ each)": ("#CC79A7", (5.0, 1.6), down),
        "false alarms (Δ⁺ each)": ("#E69F00", (1.2, 1.2), up),
    }
    if rule.has_actor:
        rest = [y - d - u for y, d, u in zip(moved, down, up, strict=True)]
        parts["the rest: the actor with its noise, and the bounds"] = (
            "#000000",
            (5.0, 1.6, 1.2, 1.6),
            rest,
        )
    figure, [axes] = panels(1, 1, (COLUMN, 3.9))
    whole = draw_curve(axes, m.name, over_episodes(moved, 1, rng), m.unfinished)
    whole.set_label("boundary, change since τ_0: " + str(whole.get_label()))
    lines = [whole]
    for name, (colour, dashes, values) in parts.items():
        curve = over_episodes(values, 1, rng)
        style: dict[str, Any] = {"color": colour, "linestyle": (0.0, dashes), "label": name}
        lines += axes.plot(curve.x, curve.centre, linewidth=1.4, **style)
        draw_band(axes, curve, colour)
    axes.set(xlabel="training episode", ylabel=data.boundary_label.replace("[", "change [", 1))
    legend(figure, lines)
    return figure


def _draw_human(data: _Data, rng: np.random.Generator) -> Figure | None:
    """Figure 7: what the human has to do, and the return that goes with it."""
    methods = _with_human(data)
    if not methods:
        return None
    figure, [left, right] = panels(1, 2, (PAGE, 3.4))
    lines: list[Line2D] = []
    for m in methods:
        interventions, gained = (
            [t[name] for t in m.played] for name in ("interventions", "return")
        )
        curve = over_episodes(interventions, data.window, rng)
        lines.append(draw_curve(left, m.name, curve, m.unfinished))
        # Episode by episode: over interventions as such, the seeds that need few would drop out.
        total = [np.cumsum(values) for values in interventions]
        burden = over_episodes(total, 1, rng)
        returns = over_episodes(gained, data.window, rng)
        right.plot(burden.centre, returns.centre, linewidth=1.6, **line_style(m.name))
        ends = [stats.trailing_mean(values, data.window)[-1] for values in gained]
        dots: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3, "alpha": 0.6}
        right.plot([values[-1] for values in total], ends, color=COLOURS[m.name], **dots)
    left.set(xlabel="training episode")
    left.set(ylabel=f"interventions per episode\n(mean of the last {data.window} episodes)")
    left.set_ylim(0.0, 1.05 * left.get_ylim()[1])
    right.set(ylabel=_return_label(data))
    right.set(xlabel="interventions so far\n(dot: last episode of a seed)")
    mark_solved(right, "solved")
    legend(figure, lines)
    return figure


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
    marker: dict[str, Any] = {"color": COLOURS[name], "marker": "o", "markerfacecolor": face}
    marker |= {"linestyle": ""}
    spread = place - 0.08 + 0.06 * (np.arange(len(means)) % 3 - 1) / 2  # so that dots overlap less
    axes.plot(spread, means, markersize=3, alpha=0.7, **marker)
    if len(means) > 1:
        interval = stats.bootstrap_interval(means, stats.mean, rng)
        axes.plot([place + 0.05] * 2, interval, color=COLOURS[name], linewidth=1.4)
    axes.plot([place + 0.05], [means.mean()], markersize=7, **marker)


def _trained(data: _Data) -> list[_Method]:
    return [m for m in data.methods if m.training]


def _with_human(data: _Data) -> list[_Method]:
    return [m for m in data.methods if m.played and m.name != "srl"]


def _column(method: _Method, name: str) -> list[np.ndarray]:
    return [t[name] for t in method.training]


def _return_label(data: _Data) -> str:
    return f"training return\n(mean of the last {data.window} episodes)"
