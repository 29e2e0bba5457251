"""One folder of the shards of a sweep."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import locked
from hitl_jax.results.config_diff import require_same
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep import fitted_human, recorded_human
from hitl_jax.sweep.shards import Shard

_NAMED = 5


class Merge(NamedTuple):
    """The shards of a sweep, checked, and the folder that they go to, locked.

    Attributes:
        folders: one for each shard.
        shards: which they are.
        out: where their runs go; what is there of the same sweep stays.
        dangerous: the recorded human of the shards, bool [T]; None where it was another.
        fitted: their fitted human; None where it was another.
    """

    folders: Sequence[ResultsFolder]
    shards: Sequence[Shard]
    out: ResultsFolder
    dangerous: np.ndarray | None
    fitted: fitted_human.FittedHuman | None

    def copy(self) -> int:
        """Copies all runs; how many the folder has then.

        Raises:
            ResultsError: if the disk refuses.
        """
        recorded_human.save_to_results(self.out.path, self.dangerous)
        fitted_human.save_to_results(self.out.path, self.fitted)
        there = self.out.finished()
        for folder, shard in zip(self.folders, self.shards, strict=True):
            for key in shard.runs():
                if key not in there:
                    self.out.copy_run(folder, key)
        return len(self.out.finished())


@contextlib.contextmanager
def prepared(folders: Sequence[ResultsFolder], out: ResultsFolder, command: str) -> Iterator[Merge]:
    """Checks the shards, and makes or opens the folder for this process alone.

    Args:
        folders: one for each shard, in any order.
        out: where their runs go.
        command: kept in the folder.

    Raises:
        ResultsError: one line, if a shard is missing, there twice, unfinished, damaged or of
            another sweep, or if `out` cannot be written.
        ValueError: one line, if a shard's recorded human is damaged.
    """
    shards = [_shard_of(folder) for folder in folders]
    _require_whole(folders, shards)
    for folder, shard in zip(folders, shards, strict=True):
        _require_finished(folder, shard)
    config = folders[0].load_config()
    dangerous, *_ = [recorded_human.load_kept(folder) for folder in folders]
    fitted, *_ = [fitted_human.load_from_results(folder) for folder in folders]
    with locked(out.path):
        out.create_or_resume(config, command)
        yield Merge(folders, shards, out, dangerous, fitted)


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
