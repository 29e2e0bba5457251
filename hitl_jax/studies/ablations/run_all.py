"""Some ablations as a command has them: what is missing is run, with progress, and all is told."""

import pathlib
from collections.abc import Mapping, Sequence

from hitl_jax.config import Method
from hitl_jax.console.output import say
from hitl_jax.console.progress import Progress
from hitl_jax.studies.ablations.runs import Group, make_runs
from hitl_jax.studies.ablations.settings import Ablation
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.ablations.write import write_ablation
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.launchers import LaunchOptions
from hitl_jax.sweep.signals import Interrupted


def opened(out: pathlib.Path) -> Store:
    """The store of a folder; one that cannot be written is noticed now.

    Raises:
        ResultsError: one line, if it is damaged or cannot be written.
    """
    store = Store(out / "runs.csv")
    store.write()
    return store


def run_all(
    chosen: Mapping[str, Ablation], groups: Sequence[Group], launch: LaunchOptions, store: Store
) -> int:
    """Runs what is missing, writes tables and figures beside the store, and prints the tables.

    Args:
        chosen: ablations by the name of their files.
        groups: of `missing_runs`.
        launch: where runs are made.
        store: of their runs.

    Returns:
        The exit code: 0, 130 after Ctrl-C, or 143 after SIGTERM.
    """
    keep_programs()
    missing = [run for group in groups for run in group.missing]
    methods = [method for method in Method if any(run.method == method for run in missing)]
    episodes = sum(group.ablation.budget.episodes * len(group.missing) for group in groups)
    code = 0
    try:
        make_runs(groups, launch, store, Progress(methods, len(missing), episodes, 0))
    except Interrupted as stop:
        say(f"\nStopped. Finished runs are in {store.path}. {launch.goes_on}")
        code = stop.exit_code
    for name, one in chosen.items():
        written = write_ablation(name, one, store)
        for line in (*written.failures, *([written.table] if written.table else ())):
            print(line)
    return code
