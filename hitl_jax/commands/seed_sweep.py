"""The main job: `hitl-jax sweep`.

Trains SRL, HITL-FIX and HITL-AC over a batch of seeds on BipedalWalker-v3, tests each trained
walker, and writes tables and Figures 4 to 7. Started again in the same folder it goes on where it
was.
"""

import contextlib
import shlex
import sys

from hitl_jax.console.cli import checking_input
from hitl_jax.console.output import say
from hitl_jax.console.progress import Progress
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.sweep.run_sweep import Sweep, prepared
from hitl_jax.sweep.signals import Interrupted


def main(options: SweepOptions) -> int:
    """Runs a sweep.

    Args:
        options: what to run.

    Returns:
        The exit code: 0, 130 after Ctrl-C, or 143 after SIGTERM.
    """
    command = shlex.join(["hitl-jax", "sweep", *sys.argv[1:]])
    with contextlib.ExitStack() as held:
        with checking_input(results="--out"):
            sweep = held.enter_context(prepared(options, command, say))
        keep_programs()
        num_runs = len(options.specs())
        done = num_runs - sweep.num_missing
        episodes = (num_runs - done) * options.scale().episodes
        progress = Progress(options.methods, num_runs, episodes, done)
        try:
            lines = Sweep(sweep, progress).run()
        except Interrupted as stop:
            say(
                f"\nStopped. Figures and tables of what there is: {options.out}. "
                f"{options.launch.goes_on}"
            )
            return stop.exit_code
        for line in lines:
            print(line)
        return 0
