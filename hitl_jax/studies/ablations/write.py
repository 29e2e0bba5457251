"""What is done of an ablation: its lines, and a table and a figure beside the store."""

import pathlib
from typing import NamedTuple

from hitl_jax.analysis.figure_style import attempt, save
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.studies.ablations import figure
from hitl_jax.studies.ablations.runs import runs_of, settings_of
from hitl_jax.studies.ablations.settings import Ablation
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.ablations.table import Line, to_markdown


class Written(NamedTuple):
    """What was written of an ablation.

    Attributes:
        table: the text, empty without a run.
        failures: a line for a figure that could not be drawn.
    """

    table: str
    failures: list[str]


def lines_of(ablation: Ablation, store: Store) -> list[Line]:
    """What is done of an ablation.

    Args:
        ablation: its settings, and its budget.
        store: the runs.

    Returns:
        A line for each setting and method that has a run.
    """
    lines = []
    for setting, parts in settings_of(ablation):
        done = [run for run in runs_of(ablation, setting, parts) if run in store]
        for method in setting.methods:
            if runs := [store[run] for run in done if run.method == method]:
                lines.append(Line(setting.label, method, runs))
    return lines


def write_ablation(name: str, ablation: Ablation, store: Store) -> Written:
    """Writes table and figure of what is done of an ablation.

    Args:
        name: of the files.
        ablation: with its budget.
        store: the runs; the files go beside it.

    Raises:
        ResultsError: if a file cannot be written.
    """
    budget, lines = ablation.budget, lines_of(ablation, store)
    if not lines:
        return Written("", [])
    told = budget.told
    done = sum(len(line.runs) for line in lines)
    asked = budget.seeds * sum(len(setting.methods) for setting in ablation.settings)
    if done < asked:
        told += (
            f"\n\n**Under way**: {done} of {asked} runs; those that end first are no fair choice."
        )
    text = to_markdown(ablation.title, told, lines)
    write_text_atomic(store.path.parent / f"{name}.md", text)
    draw = figure.draw_curves if ablation.is_number else figure.draw_rows

    def make() -> list[pathlib.Path]:
        return save(draw(ablation.title, lines), store.path.parent / name)

    return Written(text, attempt({name: make}).failures)
