"""What figures are made of: style, colours, curves with bands, legends, files.

Colours keep the paper's roles (SRL red, HITL-FIX green, HITL-AC blue) in the colour-blind-safe
shades of Okabe and Ito (https://jfly.uni-koeln.de/color/), and each method has its own line style.

Matplotlib is imported when the first figure is drawn. What the user has set of it, by a
`matplotlibrc`, a style or MPLBACKEND, changes no figure, and a figure changes nothing of that.
"""

from __future__ import annotations

import contextlib
import io
import os
import pathlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from hitl_jax.analysis.curves import Curve
from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import write_bytes_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

COLOURS = {"srl": "#D55E00", "hitl-fix": "#009E73", "hitl-ac": "#0072B2"}
GREY = "#444444"
_DASHES: dict[str, tuple[float, ...]] = {"srl": (1.2, 1.2), "hitl-fix": (5.0, 1.6), "hitl-ac": ()}
COLUMN, PAGE = 4.2, 7.2  # inches; shrunk to a paper's 3.5 and 7.2, 9 point is at least 7.5
_DOTS_PER_INCH = 250
_BAR = "|"
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


class Drawn(NamedTuple):
    """What came of drawing.

    Attributes:
        paths: the files written.
        no_data: a line for each figure that has no data yet.
        failures: a line for each figure that could not be drawn, with the reason.
    """

    paths: list[pathlib.Path]
    no_data: list[str]
    failures: list[str]

    @property
    def lines(self) -> list[str]:
        """All of it, to be printed."""
        return [*map(str, self.paths), *self.no_data, *self.failures]

    def with_(self, other: Drawn) -> Drawn:
        """What was drawn here and there."""
        return Drawn(
            self.paths + other.paths,
            self.no_data + other.no_data,
            self.failures + other.failures,
        )


def attempt(
    drawings: Mapping[str, Callable[[], list[pathlib.Path] | None]], changes: Any = _STYLE
) -> Drawn:
    """Draws figures; one that cannot be drawn keeps no other from it.

    Args:
        drawings: by name; each draws and saves a figure, and returns its files, or None without
            data for it.
        changes: of matplotlib's own settings; by default the paper's fonts, grid and frames.

    Raises:
        ResultsError: if the folder is damaged or refuses, which is no fault of a figure.
    """
    drawn = Drawn([], [], [])
    try:
        import_matplotlib()
    except Exception as error:  # Its import reads the user's files.
        return drawn._replace(failures=[_failure(drawings, error)])
    for name, draw in drawings.items():
        try:
            with style(changes):
                paths = draw()
        except ResultsError:
            raise
        except Exception as error:  # Matplotlib's, its plugins', a font's: any.
            drawn.failures.append(_failure([name], error))
            continue
        if paths is None:
            drawn.no_data.append(f"{name}: no data for it")
        else:
            drawn.paths.extend(paths)
    return drawn


def _failure(names: Iterable[str], error: Exception) -> str:
    said = " ".join(str(error).split())
    return f"{', '.join(names)}: could not be drawn: {type(error).__name__}: {said}"


def import_matplotlib() -> ModuleType:
    """Matplotlib, also where MPLBACKEND names a backend that is not there.

    A notebook's server can name its own to every process that it starts. Where it is there, it
    stays what `pyplot` would take.
    """
    if known := sys.modules.get("matplotlib"):
        return known
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = backend
    return matplotlib


@contextlib.contextmanager
def style(changes: Any = _STYLE) -> Iterator[None]:
    """Matplotlib's own settings with some changes, within a `with`, whatever the user's are."""
    matplotlib = import_matplotlib()
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(changes)
        yield


def literal(text: str) -> str:
    """A text that matplotlib shows as it is, with a "$" that begins no formula."""
    return text.replace("$", r"\$")


def line_mark(**looks: Any) -> Line2D:
    """A line for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **looks)


def patch_mark(**looks: Any) -> Patch:
    """A coloured area for a legend."""
    from matplotlib.patches import Patch

    return Patch(**looks)


def draw_curve(axes: Axes, name: str, curve: Curve, unfinished: int = 0) -> Line2D:
    """A method's curve with its band; a bar on it stands where the first seed has no more data.

    Args:
        axes: where.
        name: of the method.
        curve: over seeds.
        unfinished: how many of the seeds are under way.
    """
    label = method_label(name, curve.seeds, "no band", unfinished, curve.seeds_at[-1])
    [line] = axes.plot(curve.x, curve.centre, label=label, linewidth=1.6, **line_style(name))
    complete = int((curve.seeds_at == curve.seeds).sum())
    if 0 < complete < len(curve.x):
        line.set(marker=_BAR, markersize=9, markevery=[complete - 1])
    draw_band(axes, curve, line_style(name)["color"])
    return line


def draw_band(axes: Axes, curve: Curve, colour: str) -> None:
    """The band of a curve; none where it is of one seed."""
    if curve.seeds > 1:
        axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)


def method_label(
    name: str, seeds: int, without: str, unfinished: int = 0, last: int | None = None
) -> str:
    """A method's name with its number of seeds.

    Args:
        name: of the method.
        seeds: how many it has.
        without: what one seed cannot have.
        unfinished: how many of the seeds are under way.
        last: how many reach the end of the curve; None without a curve.
    """
    told = [f"{seeds} seeds" if seeds > 1 else f"{without}: one seed"]
    if last is not None and last < seeds:
        told.append(f"{last} at the end")
    if unfinished:
        told.append(f"{unfinished} unfinished")
    return f"{name.upper()} ({', '.join(told)})"


def threshold_line(tolerance: float) -> dict[str, Any]:
    """Looks and label of the human's own threshold [rad], as matplotlib's arguments."""
    label = f"the human's threshold, {tolerance:g} rad"
    return {"color": GREY, "linewidth": 0.9, "linestyle": "--", "label": label}


def line_style(name: str) -> dict[str, Any]:
    """Colour and dashes of a method, as matplotlib's arguments."""
    return {"color": COLOURS[name], "linestyle": (0.0, _DASHES[name])}


def mark_solved(axes: Axes, text: str, solved: float | None) -> None:
    """A dashed line at the return that solves the task, if one is known; always in view."""
    if solved is None:
        return
    axes.axhline(solved, color=GREY, linewidth=0.9, linestyle="--", zorder=1)
    low, high = axes.get_ylim()
    axes.set_ylim(top=max(high, solved + 0.12 * (solved - low)))
    place: dict[str, Any] = {"xytext": (0, 2), "textcoords": "offset points"}
    place |= {"ha": "left", "va": "bottom", "fontsize": 7.5}
    axes.annotate(text, (0.01, solved), xycoords=("axes fraction", "data"), **place)


def panels(
    rows: int, columns: int, size: tuple[float, float], sharex: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of `size` inches, and its panels row by row."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, list(figure.subplots(rows, columns, sharex=sharex, squeeze=False).flat)


def legend(
    figure: Figure,
    lines: list[Line2D],
    others: Sequence[Line2D] = (),
    band: str = "band",
    window: int | None = None,
) -> None:
    """The legend of curves over seeds, below all panels.

    Args:
        figure: drawn.
        lines: of `draw_curve`.
        others: what else there is.
        band: what the bands are called.
        window: episodes that a point is the mean of; None where it is of one.
    """
    title = f"interquartile mean over seeds; {band}: bootstrap 95 % interval"
    marks = {line.get_marker() for line in lines} - {"None"}
    if _BAR in marks:
        title += "\nright of the bar on a curve: over the seeds that got so far"
    if window:
        title += f"\nbefore episode {window}: means of the episodes so far"
    length = 3.5 if marks else None  # room for a dash on either side of a marker
    handles = [*lines, *others]
    place: dict[str, Any] = {"loc": "outside lower center", "handlelength": length}
    figure.legend(handles=handles, title=title, **place).get_title().set_multialignment("center")


def save(figure: Figure, stem: pathlib.Path) -> list[pathlib.Path]:
    """Writes a figure as PNG and SVG; the files written.

    Args:
        figure: drawn under `style`.
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
