"""How often and how long should a human intervene: `hitl-jax study`.

Each of four numbers of the human is changed by itself: how long a takeover lasts, the rest after
it, the human's delay, and how often they may intervene. Tables and a figure tell what each second
in human hands brings. What is done is kept, and not done again.
"""

import contextlib
import pathlib

from hitl_jax.config import Method
from hitl_jax.console.cli import checking_input
from hitl_jax.console.output import say
from hitl_jax.console.progress import Progress
from hitl_jax.results.atomic_files import locked
from hitl_jax.studies import intervening
from hitl_jax.studies.ablations.runs import make_runs, missing_runs
from hitl_jax.studies.ablations.store import Store
from hitl_jax.studies.ablations.write import write_ablation
from hitl_jax.studies.intervening import StudyOptions
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.signals import Interrupted


def main(options: StudyOptions) -> int:
    """Runs what is not done yet, then prints the tables.

    Args:
        options: what to run.

    Returns:
        The exit code: 0, 130 after Ctrl-C, or 143 after SIGTERM.
    """
    out = pathlib.Path(options.out)
    with contextlib.ExitStack() as held:
        with checking_input(results="--out"):
            held.enter_context(options.checked().launch.ready())
            held.enter_context(locked(out))
            store = Store(out / "runs.csv")
            store.write()  # A folder that cannot be written is noticed now.
            studied = options.studied()
            groups = missing_runs(studied.values(), store)
        keep_programs()
        missing = [run for group in groups for run in group.missing]
        say(f"{len(missing)} runs are missing of {options.env}")
        code = 0
        try:
            methods = [method for method in Method if any(run.method == method for run in missing)]
            progress = Progress(methods, len(missing), options.episodes * len(missing), 0)
            make_runs(groups, options.launch, store, progress)
        except Interrupted as stop:
            say(f"\nStopped. Finished runs are in {store.path}. {options.launch.goes_on}")
            code = stop.exit_code
        for name, one in studied.items():
            written = write_ablation(name, one, store)
            for line in (*written.failures, *([written.table] if written.table else ())):
                print(line)
        for line in intervening.draw(options, store, out / intervening.FIGURE):
            print(line)
        return code
