"""One folder of the shards of a sweep: `hitl-jax merge FOLDER...`.

    hitl-jax sweep --shard 1/2 --out runs/part-1
    hitl-jax sweep --shard 2/2 --out runs/part-2
    hitl-jax merge runs/part-1 runs/part-2 --out runs/sweep

A shard that is missing, there twice, unfinished or of another sweep is named.
"""

import contextlib
import dataclasses
import shlex
import sys

import tyro

from hitl_jax.console.cli import checking_input
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep.background_figures import draw
from hitl_jax.sweep.merge import prepared


@dataclasses.dataclass(frozen=True)
class MergeOptions:
    """Make of the shards of a sweep what one machine would have made.

    Attributes:
        folders: a folder for each shard, all of them, in any order.
        out: folder of the results. What is there of the same sweep stays.
    """

    folders: tyro.conf.Positional[tuple[str, ...]]
    out: str = "runs/sweep"


def main(options: MergeOptions) -> int:
    """Copies all runs, and draws.

    Args:
        options: what to merge.

    Returns:
        The exit code.
    """
    out = ResultsFolder(options.out)
    folders = [ResultsFolder(path) for path in options.folders]
    command = shlex.join(["hitl-jax", "merge", *sys.argv[1:]])
    with contextlib.ExitStack() as held:
        with checking_input():
            merge = held.enter_context(prepared(folders, out, command))
        print(f"{merge.copy()} runs of {len(folders)} shards: {options.out}")
        for line in draw(out):
            print(line)
    return 0
