"""One part of the team taken apart: `hitl-jax ablation NAME`.

Settings and seeds are trained side by side, tested, and compared in a table and a figure. What is
done is kept, and not done again when the command is given again or when another ablation has the
same setting.
"""

import contextlib
import pathlib

from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import say
from hitl_jax.results.atomic_files import locked
from hitl_jax.studies.ablations.options import AblationOptions
from hitl_jax.studies.ablations.run_all import opened, run_all
from hitl_jax.studies.ablations.runs import missing_runs
from hitl_jax.studies.ablations.settings import ABLATIONS


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
            store = opened(out)
            groups = missing_runs(chosen.values(), store)
        for name, one in chosen.items():
            say(f"{name}: {one.budget.told}")
        return run_all(chosen, groups, options.launch, store)
