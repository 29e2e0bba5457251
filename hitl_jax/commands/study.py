"""How often and how long should a human intervene: `hitl-jax study`.

Each of four numbers of the human is changed by itself: how long a takeover lasts, the rest after
it, the human's delay, and how often they may intervene. Tables and a figure tell what each second
in human hands brings. What is done is kept, and not done again.
"""

import contextlib
import pathlib

from hitl_jax.console.cli import checking_input
from hitl_jax.console.output import say
from hitl_jax.results.atomic_files import locked
from hitl_jax.studies import intervening
from hitl_jax.studies.ablations.run_all import opened, run_all
from hitl_jax.studies.ablations.runs import missing_runs
from hitl_jax.studies.intervening import StudyOptions


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
            store = opened(out)
            studied = options.studied()
            groups = missing_runs(studied.values(), store)
        missing = sum(len(group.missing) for group in groups)
        say(f"{missing} runs are missing of {options.env}")
        code = run_all(studied, groups, options.launch, store)
        for line in intervening.draw(options, store, out / intervening.FIGURE):
            print(line)
        return code
