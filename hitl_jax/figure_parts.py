"""What figures are made of: style, colours, curves with bands, legends, files.

Colours keep the paper's roles (SRL red, HITL-FIX green, HITL-AC blue) in the colour-blind-safe
shades of Okabe and Ito (https://jfly.uni-koeln.de/color/), and each method has its own line style.
"""

import io
import pathlib
from contextlib import AbstractContextManager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hitl_jax.curves import Curve
from hitl_jax.files import write_bytes_atomic

SOLVED = 300.0
"""The return that counts as solving BipedalWalker."""

COLOURS = {"srl": "#D55E00", "hitl-fix": "#009E73", "hitl-ac": "#0072B2"}
GREY = "#444444"
_DASHES: dict[str, tuple[float, ...]] = {"srl": (1.2, 1.2), "hitl-fix": (5.0, 1.6), "hitl-ac": ()}
COLUMN, PAGE = 4.2, 7.2  # inches; shrunk to a paper's 3.5 and 7.2, 9 point is at least 7.5
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


def paper_style() -> AbstractContextManager[None]:
    """Fonts, grid and frames of all figures, within a `with`."""
    return matplotlib.rc_context(_STYLE)


def draw_curve(axes: Axes, name: str, curve: Curve, unfinished: int = 0) -> Line2D:
    """A method's curve with its band.

    Args:
        axes: where.
        name: of the method.
        curve: over seeds.
        unfinished: how many of the seeds are under way.
    """
    label = method_label(name, curve.seeds, "no band", unfinished)
    [line] = axes.plot(curve.x, curve.centre, label=label, linewidth=1.6, **line_style(name))
    draw_band(axes, curve, line_style(name)["color"])
    return line


def draw_band(axes: Axes, curve: Curve, colour: str) -> None:
    """The band of a curve; none where it is of one seed."""
    if curve.seeds > 1:
        axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)


def method_label(name: str, seeds: int, without: str, unfinished: int = 0) -> str:
    """A method's name with its number of seeds; `without` says what one seed cannot have."""
    label = (
        f"{name.upper()} ({seeds} seeds" if seeds > 1 else f"{name.upper()} ({without}: one seed"
    )
    return label + f", {unfinished} unfinished)" if unfinished else label + ")"


def line_style(name: str) -> dict[str, Any]:
    """Colour and dashes of a method, as matplotlib's arguments."""
    return {"color": COLOURS[name], "linestyle": (0.0, _DASHES[name])}


def mark_solved(axes: Axes, text: str) -> None:
    """A dashed line at 300, always in view."""
    axes.axhline(SOLVED, color=GREY, linewidth=0.9, linestyle="--", zorder=1)
    low, high = axes.get_ylim()
    axes.set_ylim(top=max(high, SOLVED + 0.12 * (SOLVED - low)))
    place: dict[str, Any] = {"xytext": (0, 2), "textcoords": "offset points"}
    place |= {"ha": "left", "va": "bottom", "fontsize": 7.5}
    axes.annotate(text, (0.01, SOLVED), xycoords=("axes fraction", "data"), **place)


def panels(
    rows: int, columns: int, size: tuple[float, float], sharex: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of `size` inches, and its panels row by row."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(rows, columns, sharex=sharex, squeeze=False).flat)


def legend(figure: Figure, lines: list[Line2D]) -> None:
    """The legend of curves over seeds, below all panels."""
    title = "interquartile mean over seeds; band: bootstrap 95 % interval"
    marked = any(line.get_marker() != "None" for line in lines)
    length = 3.5 if marked else None  # room for a dash on either side of a marker
    figure.legend(handles=lines, title=title, loc="outside lower center", handlelength=length)


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
