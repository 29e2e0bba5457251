"""One part of the team taken apart: `hitl-jax ablation NAME`.

Settings and seeds are trained side by side, tested, and compared in a table and a figure. What is
done is kept, and not done again when the command is given again or when another ablation has the
same setting.
"""

import contextlib
import pathlib

from hitl_jax.config import Method
from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import say
from hitl_jax.console.progress import Progress
from hitl_jax.results.atomic_files import locked
from hitl_jax.studies.ablations.options import AblationOptions
from hitl_jax.studies.ablations.runs import make_runs, missing_runs
from hitl_jax.studies.ablations.settings import ABLATIONS
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.ablations.write import write_ablation
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.signals import Interrupted


def main(options: AblationOptions) -> int:
    """Runs what is not done yet, then prints the tables.

    Args:
        options: what to run.

    Returns:
        The exit code: 0, 130 after Ctrl-C, or 143 after SIGTERM.
    """
    if options.name not in (*ABLATIONS, "all"):
        raise BadInput(f"NAME {options.name}: must be one of {', '.join(ABLATIONS)}, all")
    out = pathlib.Path(options.out)
    with contextlib.ExitStack() as held:
        with checking_input(results="--out"):
            held.enter_context(options.checked().launch.ready())
            chosen = options.chosen()
            held.enter_context(locked(out))
            store = Store(out / "runs.csv")
            store.write()  # A folder that cannot be written is noticed now.
            groups = missing_runs(chosen.values(), store)
        for name, one in chosen.items():
            say(f"{name}: {one.budget.told}")
        keep_programs()
        missing = [run for group in groups for run in group.missing]
        methods = [method for method in Method if any(run.method == method for run in missing)]
        code = 0
        try:
            episodes = sum(group.ablation.budget.episodes * len(group.missing) for group in groups)
            progress = Progress(methods, len(missing), episodes, 0)
            make_runs(groups, options.launch, store, progress)
        except Interrupted as stop:
            say(f"\nStopped. Finished runs are in {store.path}. {options.launch.goes_on}")
            code = stop.exit_code
        for name, one in chosen.items():
            written = write_ablation(name, one, store)
            for line in (*written.failures, *([written.table] if written.table else ())):
                print(line)
        return code
