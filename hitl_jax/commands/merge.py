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
from collections.abc import Sequence

import numpy as np
import tyro

from hitl_jax.commands.seed_sweep import draw
from hitl_jax.console.cli import checking_input
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.results.atomic_files import locked
from hitl_jax.results.config_diff import require_same
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep import recorded_human
from hitl_jax.sweep.shards import Shard

_NAMED = 5


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
    folders = [ResultsFolder(path) for path in options.folders]
    out = ResultsFolder(options.out)
    with contextlib.ExitStack() as held:
        try:
            shards = [_shard_of(folder) for folder in folders]
            _require_whole(folders, shards)
            for folder, shard in zip(folders, shards, strict=True):
                _require_finished(folder, shard)
            config = folders[0].load_config()
            dangerous = _human_of(folders)
            held.enter_context(locked(out.path))
            command = shlex.join(["hitl-jax", "merge", *sys.argv[1:]])
            out.create_or_resume(config, command)
        except ResultsError as error:
            raise BadInput(str(error)) from error
        recorded_human.keep(out.path, dangerous)
        there = out.finished()
        for folder, shard in zip(folders, shards, strict=True):
            for key in shard.runs():
                if key not in there:
                    out.copy_run(folder, key)
        print(f"{len(out.finished())} runs of {len(folders)} shards: {options.out}")
        for line in draw(out):
            print(line)
    return 0


def _shard_of(folder: ResultsFolder) -> Shard:
    """Of which shard a folder is.

    Raises:
        ResultsError: if it is of none.
    """
    folder.load_config()  # Says so where there are no results.
    said = folder.load_shard()
    if said is None:
        raise ResultsError(f"{folder.path}: is no shard: it was made without --shard")
    return Shard(**said)


def _require_finished(folder: ResultsFolder, shard: Shard) -> None:
    """Makes sure that all runs of a shard are there, and that nothing in them is damaged.

    Raises:
        ResultsError: naming one that is not, or what is damaged.
    """
    folder.require_free(shard.runs())
    finished = folder.finished()
    missing = [key for key in shard.runs() if key not in finished]
    if missing:
        raise ResultsError(
            f"{folder.path}: shard {shard.number}/{shard.of} lacks {len(missing)} of its "
            f"{len(shard.runs())} runs ({missing[0].file_name}): give its command again"
        )
    for key in shard.runs():
        folder.check_run(key)


def _human_of(folders: Sequence[ResultsFolder]) -> np.ndarray | None:
    """The recorded human of the shards, bool [T]; None where it was simulated.

    Raises:
        BadInput: if one of them is damaged.
    """
    with checking_input():
        dangerous, *_ = [recorded_human.load_kept(folder) for folder in folders]
    return dangerous


def _require_whole(folders: Sequence[ResultsFolder], shards: Sequence[Shard]) -> None:
    """Makes sure that these are all shards of one sweep.

    Raises:
        ResultsError: naming a shard that is missing, doubled or of another sweep.
    """
    if not shards:
        raise ResultsError("FOLDER (none): must be the folders of all shards")
    config, first = folders[0].load_config(), shards[0]
    seen: dict[int, ResultsFolder] = {}
    for folder, shard in zip(folders, shards, strict=True):
        require_same(folder.path, folder.load_config(), config)
        require_same(folder.path, {"shard": shard.whole}, {"shard": first.whole})
        if shard.number in seen:
            raise ResultsError(
                f"{folder.path}: shard {shard.number}/{shard.of} is there twice: also as "
                f"{seen[shard.number].path}"
            )
        seen[shard.number] = folder
    wanted = (first._replace(number=number) for number in range(1, first.of + 1))
    # Where there are more shards than runs, some have none, and no folder.
    count = len(first.methods) * first.seeds
    missing = [one for one in wanted if one.number not in seen and one.places(count)]
    if missing:
        named = [f"{one.number}/{one.of}" for one in missing[:_NAMED]]
        more = [f"and {len(missing) - _NAMED} more"] * (len(missing) > _NAMED)
        raise ResultsError(f"shards {', '.join([*named, *more])}: missing")
