"""A sweep that is killed again and again: `hitl-jax faults`.

Makes a small sweep in one go, then twice more: once the whole of it is killed (SIGKILL) at random
moments and started again each time, once its walker processes are. A fourth one is disturbed as
people do it: its folder is moved, linked, or used twice. Compares every table and every parameter
with those of the first.
"""

import dataclasses
import pathlib
import random

from hitl_jax.choices.checks import require, require_whole
from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import say
from hitl_jax.envs import require_backend
from hitl_jax.faults.killed_sweeps import (
    differences,
    disturb_sweep,
    kill_sweeps,
    kill_workers,
    make_whole,
)
from hitl_jax.results.folder import ResultsFolder


@dataclasses.dataclass(frozen=True)
class FaultOptions:
    """Kill and disturb small sweeps at random moments; they must end as if nothing had happened.

    Attributes:
        kills: of the whole sweep, and again of single walker processes.
        moves: of its folder, links put in its place, second starts, foreign runs.
        first: what the random moments start from.
        longest: longest time from a start, or from the first save after it, to a kill [s]; half of
            it for walker processes.
        out: a new folder for the four sweeps.
    """

    kills: int = 20
    moves: int = 20
    first: int = 0
    longest: float = 6.0
    out: str = "runs/faults"


def main(options: FaultOptions) -> int:
    """Runs the sweeps, and compares.

    Args:
        options: how often to kill.

    Returns:
        The exit code: 0 if all is equal, else 1.

    Raises:
        BadInput: if the folder is there already.
    """
    with checking_input():
        for name in ("kills", "moves"):
            require_whole(name, getattr(options, name))
        require("longest", options.longest, at_least=0.1)
        require_backend("lean")  # Its walkers have processes that can be killed.
    out = pathlib.Path(options.out)
    if out.exists():
        raise BadInput(f"--out {out}: is there already; name a new folder")
    out.mkdir(parents=True)
    moments, longest = random.Random(options.first), options.longest
    make_whole(out / "whole")
    say("made in one go")
    if options.kills:
        kill_sweeps(out / "killed", moments, longest, options.kills, say)
        kill_workers(out / "workers", moments, longest / 2, options.kills, say)
    wrong = disturb_sweep(out, moments, longest, options.moves, say) if options.moves else []
    differ = [
        path
        for name in ("killed", "workers", "disturbed")
        if (out / name).exists()
        for path in differences(ResultsFolder(out / "whole"), ResultsFolder(out / name))
    ]
    for path in differ:
        print(f"differs: {path}")
    print("differences were found" if differ else "all tables and parameters are equal")
    return 1 if differ or wrong else 0
