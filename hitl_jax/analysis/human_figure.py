"""Figure 7: what the human has to do, and the return that goes with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.curves import over_episodes
from hitl_jax.analysis.figure_data import FigureData
from hitl_jax.analysis.figure_style import (
    COLOURS,
    PAGE,
    draw_curve,
    legend,
    line_style,
    mark_solved,
    panels,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


def work(data: FigureData) -> Figure | None:
    """Interventions over training, and the return over interventions."""
    if not data.with_human:
        return None
    figure, [left, right] = panels(1, 2, (PAGE, 3.5))
    lines: list[Line2D] = []
    for m in data.with_human:
        interventions, gained = (
            [t[name] for t in m.played] for name in ("interventions", "return")
        )
        curve = over_episodes(interventions, data.window)
        lines.append(draw_curve(left, m.name, curve, m.unfinished))
        # Episode by episode: over interventions as such, the seeds that need few would drop out.
        total = [np.cumsum(values) for values in interventions]
        burden = over_episodes(total, 1)
        returns = over_episodes(gained, data.window)
        right.plot(burden.centre, returns.centre, linewidth=1.6, **line_style(m.name))
        ends = [stats.trailing_mean(values, data.window)[-1] for values in gained]
        dots: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3, "alpha": 0.6}
        right.plot([values[-1] for values in total], ends, color=COLOURS[m.name], **dots)
    left.set(xlabel="training episode")
    left.set(ylabel=f"interventions per episode\n({data.averaged})")
    left.set_ylim(0.0, 1.05 * left.get_ylim()[1])
    right.set(ylabel=data.return_label)
    right.set(xlabel="interventions so far\n(dot: last episode of a seed)")
    mark_solved(right, "solved", data.solved)
    legend(figure, lines, band="band, on the left", window=data.window)
    return figure
