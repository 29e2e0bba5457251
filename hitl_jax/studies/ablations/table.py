"""An ablation as a table in Markdown."""

from typing import NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.markdown import table
from hitl_jax.studies.ablations.store import AREA, FALLS, Row


class Line(NamedTuple):
    """One line of the table: a setting under one method.

    Attributes:
        label: the setting's.
        method: the method.
        runs: what its seeds measured.
    """

    label: str
    method: str
    runs: list[Row]

    def values(self, measure: str) -> np.ndarray:
        """Of the seeds that have one."""
        return np.array([run[measure] for run in self.runs if run.get(measure) is not None])


_MEASURES = (
    ("env_steps", "steps", 0),
    ("test_return_mean", "autonomous test return", 0),
    ("test_fall_rate", "falls in it", 2),
    (AREA, "area under the tests over the run's steps", 0),
    (FALLS, "falls in training", 0),
    ("assisted_return_mean", "assisted test return", 0),
    ("assisted_takeover_rate", "steps under the human in it", 3),
    ("train_interventions", "interventions", 0),
    ("train_human_steps", "steps under the human", 0),
    ("alarm_agreement", "alarms confirmed", 2),
    ("final_boundary", "last boundary", 2),
    ("settled_boundary", "mean boundary of the last 20 episodes", 2),
    ("late_intervened", "last fifth: episodes with an intervention", 2),
    ("late_return_with", "return learned from in these", 0),
    ("late_return_without", "in the others", 0),
    ("late_steps_with", "steps in these", 0),
    ("late_steps_without", "in the others", 0),
)
"""(measure, heading, decimals); one that no run has is left out."""

_GUIDE = """\
Means over seeds [bootstrap 95 % interval], and the interquartile mean of the autonomous test return
after them. Every run has the same number of training episodes; a human who resets early makes them
short, so steps differ. The area under the tests is an average over the steps that a run took, of a
test every twentieth of training: longer runs have more of them late. A diverged run counts as
falling at once from there on. "–": no seed has the measure; "(n = 7)": 7 have it. The last fifth of
training is told of the episodes that the human watched; falls in training are those of all
episodes."""


def to_markdown(title: str, budget: str, lines: list[Line]) -> str:
    """The table with its heading.

    Args:
        title: of the ablation.
        budget: what every run had, in a few words.
        lines: in their order.
    """
    measures = [one for one in _MEASURES if any(line.values(one[0]).size for line in lines)]
    head = ["setting", "method", "seeds", *(name for _, name, _ in measures)]
    cells = [head]
    for line in lines:
        lost = sum(run["diverged"] for run in line.runs)
        seeds = f"{len(line.runs)} ({lost:.0f} diverged)" if lost else str(len(line.runs))
        row = [line.label, line.method, seeds]
        cells.append([*row, *(_cell(line, measure, decimals) for measure, _, decimals in measures)])
    return f"# {title}\n\n{budget}\n\n{_GUIDE}\n\n{table(cells)}"


def _cell(line: Line, measure: str, decimals: int) -> str:
    values = line.values(measure)
    if not values.size:
        return "–"
    text = f"{stats.estimate(values, stats.mean):,.{decimals}f}"
    if measure == "test_return_mean":
        text += f"; {float(stats.interquartile_mean(values, 0)):,.{decimals}f}"
    return text if values.size == len(line.runs) else f"{text} (n = {values.size})"
