"""Figure 6: the switching boundary over training, and what moved it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hitl_jax.analysis.curves import over_episodes
from hitl_jax.analysis.figure_data import FigureData
from hitl_jax.analysis.figure_style import (
    COLOURS,
    COLUMN,
    draw_band,
    draw_curve,
    legend,
    line_mark,
    mark_solved,
    panels,
    threshold_line,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


_WINDOW = 8
"""Episodes; in training some have no action noise, others no human, every second or fourth."""


def boundary(data: FigureData) -> Figure | None:
    """The boundary over training beside the human's own threshold, and the return below."""
    if not data.with_human:
        return None
    from matplotlib.patheffects import withStroke

    figure, [upper, lower] = panels(2, 1, (COLUMN, 5.6), sharex=True)
    outline: list[Any] = [withStroke(linewidth=3.4, foreground="white")]
    lines: list[Line2D] = []
    others: list[Line2D] = []
    for m in data.with_human:
        if m.name == "hitl-ac":  # the others' boundaries do not differ from seed to seed
            alpha = 3.5 / max(len(m.played), 10)
            thin: dict[str, Any] = {"color": COLOURS[m.name], "alpha": alpha, "linewidth": 0.5}
            for t in m.played:
                upper.plot(t["episode"], t["mean_boundary"], **thin)
            others.append(
                line_mark(
                    label=f"{m.name.upper()}, each episode of each seed", **thin | {"alpha": 0.35}
                )
            )
        curve = over_episodes([t["mean_boundary"] for t in m.played], _WINDOW)
        draw_curve(upper, m.name, curve).set_path_effects(outline)
        curve = over_episodes(m.column("return"), data.window)
        lines.append(draw_curve(lower, m.name, curve, m.unfinished))
    if data.tolerance is not None:
        style = threshold_line(data.tolerance)
        upper.axhline(data.tolerance, **style)
        others.append(line_mark(**style))
    upper.set(ylabel=f"{data.boundary_label}\n(mean of the last {_WINDOW} episodes)")
    lower.set(xlabel="training episode", ylabel=data.return_label)
    mark_solved(lower, "solved", data.solved)
    legend(figure, lines, others, window=data.window)
    return figure


def moves(data: FigureData) -> Figure | None:
    """What moved HITL-AC's boundary from τ_0: alarms, by line 8, or the actor."""
    methods = [m for m in data.with_human if m.name == "hitl-ac"]
    if not methods or data.rule is None:
        return None
    [m] = methods
    rule = data.rule
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
    whole = draw_curve(axes, m.name, over_episodes(moved, 1), m.unfinished)
    whole.set_label("boundary, change since τ_0: " + str(whole.get_label()))
    lines = [whole]
    for name, (colour, dashes, values) in parts.items():
        curve = over_episodes(values, 1)
        style: dict[str, Any] = {"color": colour, "linestyle": (0.0, dashes), "label": name}
        lines += axes.plot(curve.x, curve.centre, linewidth=1.4, **style)
        draw_band(axes, curve, colour)
    axes.set(xlabel="training episode", ylabel=data.boundary_label.replace("[", "change [", 1))
    legend(figure, lines)
    return figure
