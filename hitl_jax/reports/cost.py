"""What the choices cost: the kept runs on seeds of tuning."""

import pathlib

from hitl_jax.analysis.markdown import table
from hitl_jax.config import Method
from hitl_jax.studies.ablations.runs import runs_of, settings_of
from hitl_jax.studies.ablations.settings import ABLATIONS
from hitl_jax.studies.ablations.store import RunId, Store
from hitl_jax.studies.tuning.options import CONFIGURATIONS, TuningOptions

_RATE = 1_200
"""Environment steps of training that a core makes in a second, with the tests that belong to them:
7.9 million in 54 minutes on two cores (`fading` in results/README.md)."""


def cost_of_choices(root: pathlib.Path) -> str:
    """A table of what was run to choose: how many runs on which seeds, and for how long.

    Args:
        root: the folder of results.

    Raises:
        ResultsError: if the ablations' runs are damaged.
    """
    rows: list[tuple[str, str, int, float]] = []
    tuning = TuningOptions()
    kept = [(root / "tuning" / f"{name}.json").exists() for name in CONFIGURATIONS]
    if any(kept):
        count = sum(kept) * len(Method) * tuning.seeds
        steps = float(count * tuning.ticks)
        rows.append(("learner", _seeds(tuning.first_seed, tuning.seeds), count, steps))
    store = Store(root / "ablations" / "runs.csv")
    told: set[RunId] = set()
    for name, ablation in ABLATIONS.items():
        budget = ablation.budget
        if budget.first_seed < tuning.first_seed:
            continue
        runs = {
            run
            for setting, parts in settings_of(ablation)
            for run in runs_of(ablation, setting, parts)
            if run in store
        }
        new, told = runs - told, told | runs
        if new:
            steps = sum(store[run]["env_steps"] for run in new)
            rows.append((name, _seeds(budget.first_seed, budget.seeds), len(new), steps))
    lines = [["choice", "seeds", "runs", "million steps", "core hours"]]
    lines += [
        [name, seeds, str(count), f"{steps / 1e6:.1f}", f"{steps / _RATE / 3600:.1f}"]
        for name, seeds, count, steps in rows
    ]
    if not rows:
        return ""
    return (
        "## What the choices cost\n\n"
        "Kept runs on seeds of tuning; a run of two tables counts in the first. Core hours are "
        f"reckoned from the steps of training, at {_RATE:,} a second with the tests that belong to "
        f"them.\n\n{table(lines)}"
    )


def _seeds(first: int, count: int) -> str:
    return f"{first} to {first + count - 1}"
