"""The command line: `hitl-jax sweep`, or `python -m hitl_jax sweep`."""

import importlib
import sys
from collections.abc import Sequence

from hitl_jax.console.output import go_on_without_readers, replace_what_cannot_be_encoded
from hitl_jax.xla.loop_flag import have_loops_in_one_kernel

_COMMANDS = {
    "sweep": ("seed_sweep", "trains and tests the three methods over many seeds"),
    "figures": ("figures", "draws the figures of a results folder"),
    "alarms": ("alarms", "tells how well alarms foretell falls, at any boundary"),
    "assistance": ("assistance", "tells what a human's help is worth at equal human time"),
    "boundary-map": ("boundary_map", "draws the boundary over the state"),
    "replay": ("replay", "films an episode of a results folder"),
    "verify": ("verify", "plays kept episodes again and compares"),
    "merge": ("merge", "makes one folder of the shards of a sweep"),
    "live": ("live", "opens a page on which you are the human"),
    "recorded": ("recorded", "makes a human for sweeps of a live session"),
    "participants": ("participants", "makes one table of the live sessions of several people"),
    "export": ("export", "writes episodes as a Minari dataset"),
    "import": ("import_human", "fits a human for sweeps to a Minari dataset"),
    "ablation": ("ablation", "takes one part of the team apart"),
    "study": ("study", "tells how often and how long a human should intervene"),
    "tuning": ("tuning", "tells what a learner's configuration costs and gives"),
    "human": ("human", "makes the trained human of a task"),
    "report": ("report", "writes the report and all figures from saved results"),
    "benchmark": ("benchmark", "measures how fast each part is on this machine"),
    "agreement": ("agreement", "compares the walker in JAX with Box2D's"),
    "brax-ppo": ("brax_ppo", "trains Brax's PPO on the walker in JAX"),
    "faults": ("faults", "kills sweeps again and again and compares results"),
}
"""Each command: its module in `hitl_jax.commands`, and what it does.

A module's `main` takes one dataclass of options, and returns the exit code."""


def main(words: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        words: the command's name and its options (default: the process's).

    Returns:
        The exit code; 2 for bad input, after one line on stderr.
    """
    replace_what_cannot_be_encoded()
    go_on_without_readers()
    name, *options = (sys.argv[1:] if words is None else words) or ["--help"]
    if name in ("-h", "--help"):
        lines = [f"  {command:14}{purpose}" for command, (_, purpose) in _COMMANDS.items()]
        usage = "usage: hitl-jax COMMAND [OPTIONS]    (--help after a command lists its options)\n"
        try:
            print("\n".join([usage, *lines]), flush=True)
        except OSError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
        return 0
    if name not in _COMMANDS:
        print(f"error: {name}: must be one of {', '.join(_COMMANDS)}", file=sys.stderr)
        return 2
    # Before JAX makes an array, so that all commands round alike: what one has played another plays
    # again. Processes that a command starts inherit it.
    have_loops_in_one_kernel()
    from hitl_jax.console.cli import run_main

    sys.argv[1:] = options  # A folder of results keeps the command that made it.
    module = importlib.import_module(f"hitl_jax.commands.{_COMMANDS[name][0]}")
    return run_main(name, module.main, options)


if __name__ == "__main__":
    sys.exit(main())
