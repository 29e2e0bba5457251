"""The report's section of ablations."""

import pathlib
from collections.abc import Callable, Iterator

from hitl_jax.analysis.figure_style import attempt, save
from hitl_jax.config import Method
from hitl_jax.studies.ablations.human_time import draw_human_time, measured
from hitl_jax.studies.ablations.settings import ABLATIONS
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.ablations.write import lines_of, write_ablation

_COMPARED = (Method.HITL_FIX, Method.HITL_AC)
_BASE = "Settings change the options of `sweep --preset paper --learner td3-tqc`, the base.\n"


def ablations(folder: pathlib.Path, say: Callable[[str], None]) -> str:
    """All ablations of a folder, each with its table and its figure.

    Args:
        folder: where their runs are kept.
        say: is told which figures could not be drawn, and why.

    Raises:
        ResultsError: if it is damaged or cannot be written.
    """
    title = "## Ablations\n"
    store = Store(folder / "runs.csv")
    if not store.path.exists():
        return f"{title}\nNot run yet.\n"
    parts = [title, _BASE]
    for name, ablation in ABLATIONS.items():
        text, failures = write_ablation(name, ablation, store)
        for failure in failures:
            say(failure)
        if text:
            command = f"    hitl-jax ablation {name} --out results/ablations\n"
            picture = f"![{ablation.title}](ablations/{name}.png)\n"
            parts += [text.replace("# ", "### ", 1), command, picture]
        else:
            parts.append(f"### {ablation.title}\n\nNot run yet.\n")
    return "\n".join([*parts, *_human_time(folder, store, say)])


_TIME = "human-time"
_BY_START = "initial-boundary"


def _human_time(folder: pathlib.Path, store: Store, say: Callable[[str], None]) -> Iterator[str]:
    """What the human's time brings with fixed and learned boundaries, once every run is there."""
    ablation = ABLATIONS[_BY_START]
    lines = measured(lines_of(ablation, store))
    whole = [line for line in lines if len(line.runs) == ablation.budget.seeds]
    if len(whole) == sum(len(setting.methods) for setting in ablation.settings):
        curves = [[line for line in whole if line.method == method] for method in _COMPARED]
        drawn = attempt({_TIME: lambda: save(draw_human_time("τ_0", curves), folder / _TIME)})
        for failure in drawn.failures:
            say(failure)
        yield f"### What the human's time brings\n\n![{_TIME}](ablations/{_TIME}.png)\n"
