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
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hitl_jax import stats
from hitl_jax.files import write_bytes_atomic
from hitl_jax.results import ResultsFolder, flatten
from hitl_jax.tables import METHODS, Table, select

SOLVED = 300.0
"""The return that counts as solving BipedalWalker."""

_COLOURS = {"srl": "#D55E00", "hitl-fix": "#009E73", "hitl-ac": "#0072B2"}
_DASHES: dict[str, tuple[float, ...]] = {"srl": (1.2, 1.2), "hitl-fix": (5.0, 1.6), "hitl-ac": ()}
_COLUMN, _PAGE = 4.2, 7.2  # inches; shrunk to a paper's 3.5 and 7.2, 9 point is at least 7.5
_DOTS_PER_INCH = 250
_MAX_POINTS = 250  # of a curve: more cannot be seen
_BAND_TITLE = "interquartile mean over seeds; band: bootstrap 95 % interval"
_STYLE = {
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
    """One method's data: training episodes of all runs, test episodes of the finished ones."""

    name: str
    training: list[Table]
    unfinished: int
    tests: list[Table]


class _Data(NamedTuple):
    """What the figures draw; `window` is the number of episodes that returns are smoothed over."""

    methods: list[_Method]
    window: int
    boundary_label: str


class _Curve(NamedTuple):
    """A statistic of `seeds` seeds and its band at the points x, each [T]."""

    x: np.ndarray
    centre: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seeds: int


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
        "figure6_boundary": _draw_boundary,
        "figure7_human": _draw_human,
    }
    paths: list[pathlib.Path] = []
    notes: list[str] = []
    with matplotlib.rc_context(_STYLE):
        for name, draw in drawings.items():
            figure = draw(data, rng)
            if figure is None:
                notes.append(f"{name}: no data for it yet")
                continue
            paths += _save(figure, folder.path / "figures" / name)
    return paths, notes


def _load(folder: ResultsFolder) -> _Data:
    config = flatten(folder.load_config())
    runs, partials = folder.load_all(), folder.load_partials()
    methods = []
    for name in METHODS:
        finished = [run for run in runs if run.key.method == name]
        begun = [t for key, t in partials.items() if key.method == name and len(t["episode"])]
        training = [run.episodes for run in finished if len(run.episodes["episode"])] + begun
        tests = [run.tests for run in finished if len(run.tests["episode"])]
        if training or tests:
            methods.append(_Method(name, training, len(begun), tests))
    longest = max((len(t["episode"]) for m in methods for t in m.training), default=0)
    indicators = [value for key, value in config.items() if key.split(".")[-1] == "indicator"]
    in_radians = set(indicators) <= {"hull_angle"}
    label = "boundary [rad]" if in_radians else f"boundary [unit of {indicators[0]}]"
    return _Data(methods, int(np.clip(longest // 10, 20, 100)), label)


def _draw_training(data: _Data, rng: np.random.Generator) -> Figure | None:
    curves = {m: _over_episodes(m, "return", data.window, rng) for m in _trained(data)}
    return _draw_returns(data, curves, "training episode")


def _draw_steps(data: _Data, rng: np.random.Generator) -> Figure | None:
    curves = {}
    for m in _trained(data):
        returns = [stats.trailing_mean(t["return"], data.window) for t in m.training]
        curves[m.name] = m, _against([t["env_steps"] / 1000 for t in m.training], returns, rng)
    return _draw_returns(data, curves, "environment steps [thousands]")


def _draw_returns(data: _Data, curves: dict[str, _Curve], x_label: str) -> Figure | None:
    return None
