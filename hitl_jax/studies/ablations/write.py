"""What is done of an ablation: its lines, and a table and a figure beside the store."""

import pathlib
from typing import NamedTuple

from hitl_jax.analysis.figure_style import attempt, save
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.studies.ablations import figure
from hitl_jax.studies.ablations.options import AblationOptions
from hitl_jax.studies.ablations.runs import runs_of, settings_of
from hitl_jax.studies.ablations.settings import ABLATIONS
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


def lines_of(name: str, options: AblationOptions, store: Store) -> list[Line]:
    """What is done of an ablation.

    Args:
        name: one of `ABLATIONS`.
        options: seeds and budget.
        store: the runs.

    Returns:
        A line for each setting and method that has a run.
    """
    lines = []
    for setting, parts in settings_of(ABLATIONS[name]):
        done = [run for run in runs_of(setting, parts, options) if run in store]
        for method in setting.methods:
            if runs := [store[run] for run in done if run.method == method]:
                lines.append(Line(setting.label, method, runs))
    return lines


def write_ablation(name: str, options: AblationOptions, store: Store) -> Written:
    """Writes table and figure of what is done of an ablation.

    Args:
        name: one of `ABLATIONS`.
        options: seeds and budget.
        store: the runs; the files go beside it.

    Raises:
        ResultsError: if a file cannot be written.
    """
    lines = lines_of(name, options, store)
    if not lines:
        return Written("", [])
    last = options.first_seed + options.seeds - 1
    budget = (
        f"Seeds {options.first_seed} to {last}, {options.episodes} training episodes, "
        f"{options.test_episodes} test episodes each way."
    )
    done = sum(len(line.runs) for line in lines)
    asked = options.seeds * sum(len(setting.methods) for setting in ABLATIONS[name].settings)
    if done < asked:
        budget += (
            f"\n\n**Under way**: {done} of {asked} runs; those that end first are no fair choice."
        )
    ablation = ABLATIONS[name]
    text = to_markdown(ablation.title, budget, lines)
    write_text_atomic(store.path.parent / f"{name}.md", text)
    draw = figure.draw_curves if ablation.is_number else figure.draw_rows

    def make() -> list[pathlib.Path]:
        return save(draw(ablation.title, lines), store.path.parent / name)

    return Written(text, attempt({name: make}).failures)
