"""Runs under way on disk, so that a sweep that was stopped goes on where it was.

::

    FOLDER/frames-000012.npz    replay frames that the runs added since save 11
    FOLDER/state-000012.npz     all else of each run, and which frames belong to it

A save is valid once its state file is whole. The state before it is kept, in case the newest cannot
be read; frames are kept as long as one of the two needs them, and never changed. A file is an npz
with a checksum behind it; reading executes nothing (no pickle).
"""

import contextlib
import hashlib
import json
import pathlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from hitl_jax.errors import ResultsError
from hitl_jax.results.atomic_files import (
    named_errors,
    read_bytes,
    remove_leftovers,
    require_held,
    write_bytes_atomic,
)
from hitl_jax.results.config_diff import changes
from hitl_jax.results.diagnostic_table import diagnostics_from_csv, diagnostics_to_csv
from hitl_jax.results.episode_tables import (
    EPISODE_COLUMNS,
    Table,
    table_from_csv,
    table_to_csv,
    to_columns,
    to_table,
)
from hitl_jax.results.json_documents import checked, plain_from_json
from hitl_jax.results.npz_archives import from_npz, to_npz
from hitl_jax.results.provenance import origin
from hitl_jax.results.recorded_episodes import BEST, FIRST_INTERVENTION
from hitl_jax.results.run_key import RunKey
from hitl_jax.results.schemas import MadeBy, SaveHead
from hitl_jax.training.saved_run import SavedRun

FORMAT = 6
"""Of a save; another one's is refused. The order of the words of `xla.pytree_words` is part of
it."""

_TABLES = ("episodes", "diagnostics")
"""Of a run's facts, as CSV; the others are in the head."""

_DIGEST_SIZE = 16  # bytes
_ARRAYS = tuple(name for name in SavedRun._fields if name not in ("facts", "frames"))

_FORMS = {
    "train": (np.uint32, (1,)),
    "acting": (np.uint32, (1,)),
    "behavior": (np.float32, (2,)),
    "snapshots": (np.float32, (1, 2)),
    "boundaries": (np.float32, (1, 2)),
    "observation": (np.float32, (1,)),
    "steps": (np.float32, (2,)),
    "recordings": (np.float32, (2,)),
}
"""Type of the numbers, and how many dimensions there may be."""

Lengths = dict[int, dict[str, int]]
"""Frames of each run, by its name, in each numbered file."""


class Saves:
    """A folder of saves; one writer at a time.

    Args:
        path: the folder, there or not.
        capacity: frames that a run's replay holds; what is older need not be kept.
    """

    def __init__(self, path: pathlib.Path, capacity: int):
        self._path = path
        self._capacity = capacity
        self._number = 0  # the highest of any file
        self._newest = 0  # the save that counts
        self._lengths: Lengths = {}

    def load(self) -> tuple[dict[RunKey, SavedRun], list[str]]:
        """The newest save that can be read.

        Returns:
            The runs, and a line for each newer save that is damaged.

        Raises:
            ResultsError: if there are saves, and none can be read.
        """
        notes: list[str] = []
        with named_errors(self._path):
            remove_leftovers(self._path)
        states = self._numbers("state")
        self._number = max(states | self._numbers("frames"), default=0)
        for number in sorted(states, reverse=True):
            try:
                runs, self._lengths = self._load(number)
            except ResultsError as error:
                notes.append(str(error))
                continue
            self._newest = number
            return runs, notes
        if notes:
            raise ResultsError(
                f"{self._path}: no save can be read ({notes[0]}); remove the folder to begin the "
                "runs under way anew"
            )
        return {}, notes

    def write(self, runs: Sequence[SavedRun]) -> None:
        """Adds a save; the frames of each run are those since the save before.

        Raises:
            ResultsError: if the disk refuses; the save before still counts.
        """
        require_held(self._path)
        with named_errors(self._path):
            self._path.mkdir(exist_ok=True)  # Not its parents: results that vanished stay away.
        number = self._number + 1
        names = [run.key.file_name for run in runs]
        new = dict(zip(names, (run.frames for run in runs), strict=True))
        before = self._lengths
        lengths = before | {number: {name: len(frames) for name, frames in new.items()}}
        lengths = _reaching_back(lengths, dict.fromkeys(names, self._capacity))
        _write(self._file("frames", number), new)
        arrays: dict[str, np.ndarray] = {}
        facts = []
        for index, run in enumerate(runs):
            arrays |= {f"{index}/{name}": getattr(run, name) for name in _ARRAYS}
            columns = to_columns(run.facts["episodes"], EPISODE_COLUMNS)
            arrays[f"{index}/episodes"] = _to_bytes(
                table_to_csv(to_table(columns, EPISODE_COLUMNS))
            )
            diagnostics = diagnostics_to_csv(run.facts["diagnostics"])
            arrays[f"{index}/diagnostics"] = _to_bytes(diagnostics)
            facts.append({name: run.facts[name] for name in run.facts if name not in _TABLES})
        head = {"format": FORMAT, "runs": facts, "frames": lengths}
        arrays["head"] = _to_bytes(json.dumps(head, allow_nan=False))
        _write(self._file("state", number), arrays)
        self._keep("state", {self._newest, number})
        self._keep("frames", {*before, *lengths})
        self._number, self._newest, self._lengths = number, number, lengths

    def remove(self) -> None:
        """Removes all saves, and the folder if nothing else is in it: nothing is under way."""
        self._keep("state", set())  # First, since a state without its frames is damaged.
        self._keep("frames", set())
        if not self._path.is_symlink():  # Another disk's folder stays where its link leads.
            with contextlib.suppress(OSError):  # It is not there, or somebody has files in it.
                self._path.rmdir()

    def _load(self, number: int) -> tuple[dict[RunKey, SavedRun], Lengths]:
        path = self._file("state", number)
        arrays = _read(path)
        with named_errors(path):
            if "head" not in arrays:
                raise ValueError("has no head")
            text = _to_text(arrays["head"])
            head = plain_from_json(text, dict[str, Any])
            if head.get("format") != FORMAT:
                told = f"is of format {head.get('format')!r}, another version's{_by(head)}"
                raise ResultsError(f"{path}: {told}: must be {FORMAT}")
            checked(head, SaveHead)
            return self._assemble(head, arrays)

    def _assemble(
        self, head: dict[str, Any], arrays: dict[str, np.ndarray]
    ) -> tuple[dict[RunKey, SavedRun], Lengths]:
        lengths: Lengths = {int(number): names for number, names in head["frames"].items()}
        files = {number: _read(self._file("frames", number)) for number in sorted(lengths)}
        for number, file in files.items():
            if {name: frames.shape[:1] for name, frames in file.items()} != {
                name: (length,) for name, length in lengths[number].items()
            }:
                raise ValueError(f"{self._file('frames', number)} is of another save")
        runs = {}
        for index, facts in enumerate(head["runs"]):
            if lacking := [n for n in (*_ARRAYS, "episodes") if f"{index}/{n}" not in arrays]:
                raise ValueError(f"lacks {lacking[0]} of run {index}")
            parts = {name: arrays[f"{index}/{name}"] for name in _ARRAYS}
            _require_forms(facts, parts)
            csv = _to_text(arrays[f"{index}/episodes"]).decode()
            rows = _rows(table_from_csv(csv, EPISODE_COLUMNS))
            _require_rows(facts, rows)
            # A save of a commit that took no samples has none.
            csv = _to_text(arrays.get(f"{index}/diagnostics", _to_bytes(""))).decode()
            tables = {"episodes": rows, "diagnostics": _rows(diagnostics_from_csv(csv))}
            saved = SavedRun(facts | tables, frames=np.array([]), **parts)
            name = saved.key.file_name
            if saved.key in runs:
                raise ValueError(f"{saved.key} is there twice")
            has = [file[name] for file in files.values() if name in file]
            shapes = {(frames.dtype.kind, frames.ndim, frames.shape[1:]) for frames in has}
            if not has or len(shapes) > 1 or next(iter(shapes))[:2] != ("f", 2):
                raise ValueError(f"has no frames of {saved.key}, or of several kinds")
            frames = np.concatenate(has)
            if len(frames) < min(facts["ticks"], self._capacity):
                raise ValueError(f"lacks frames of {saved.key}")
            frames = frames[-min(facts["ticks"], self._capacity) :]
            runs[saved.key] = saved._replace(frames=frames)
        return runs, lengths

    def _keep(self, kind: str, numbers: set[int]) -> None:
        """Removes the others."""
        for number in self._numbers(kind) - numbers:
            require_held(self._path)
            with named_errors(self._file(kind, number)):
                self._file(kind, number).unlink()

    def _file(self, kind: str, number: int) -> pathlib.Path:
        return self._path / f"{kind}-{number:06d}.npz"

    def _numbers(self, kind: str) -> set[int]:
        found = (
            re.fullmatch(rf"{kind}-([0-9]{{6,9}})\.npz", path.name) for path in self._path.glob("*")
        )
        numbers = {int(match[1]) for match in found if match}
        return {number for number in numbers if self._file(kind, number).is_file()}


def _require_forms(facts: dict[str, Any], parts: dict[str, np.ndarray]) -> None:
    """Refuses arrays that are none of a run's; their lengths only the run itself knows."""
    for name, array in parts.items():
        dtype, dimensions = _FORMS[name]
        # Nothing of a kind is written as an array of any type.
        if array.ndim not in dimensions or (array.size and array.dtype != dtype):
            raise ValueError(f"{name} of a run is {array.dtype} {array.shape}")
    if sum(length for _, length in facts["recordings"].values()) != len(parts["recordings"]):
        raise ValueError("the recordings of a run have other lengths than it says")
    if len(parts["snapshots"]) != len(parts["boundaries"]):
        raise ValueError("a run has other numbers of snapshots and boundaries")
    if facts["ticks"] < facts["env_steps"]:
        raise ValueError("a run has more steps than ticks")


def _require_rows(facts: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Refuses episodes that are none of a run's."""
    if [row["episode"] for row in rows] != list(range(1, len(rows) + 1)):
        raise ValueError("the episodes of a run are not numbered from 1 on")
    for name, (episode, length) in facts["recordings"].items():
        if name not in (FIRST_INTERVENTION, BEST) or episode > len(rows):
            raise ValueError(f"recording {name[:50]!r} is of no episode of its run")
        if rows[episode - 1]["length"] != length:
            raise ValueError(f"recording {name!r} has another length than its episode")
    if facts["diverged"] and facts["diverged"][2] > len(rows):
        raise ValueError("a run diverged after more episodes than it has")


def _by(head: dict[str, Any]) -> str:
    """By which code and packages a save was made, as far as they are not today's."""
    runs = head.get("runs")
    try:
        made = checked(runs[0] if isinstance(runs, list) and runs else {}, MadeBy)
    except ValueError:
        return ""
    found = {"commit": "+".join(made.commits)} if made.commits else {}
    differences = changes(found | {"versions": made.versions}, origin())
    return f" ({'; '.join(differences)})" if differences else ""


def _reaching_back(lengths: Lengths, needed: dict[str, int]) -> Lengths:
    """Of all files those that hold one of the last so many frames of a run."""
    kept: Lengths = {}
    for number in sorted(lengths, reverse=True):
        lacking = (length and needed.get(name, 0) > 0 for name, length in lengths[number].items())
        if not kept or any(lacking):  # The newest names every run, some perhaps without frames.
            kept[number] = lengths[number]
        for name, length in lengths[number].items():
            needed[name] = needed.get(name, 0) - length
    return kept


def _rows(table: Table) -> list[dict[str, Any]]:
    columns = {name: values.tolist() for name, values in table.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _write(path: pathlib.Path, arrays: dict[str, np.ndarray]) -> None:
    data = to_npz(arrays)
    write_bytes_atomic(path, data + digest(data))


def _read(path: pathlib.Path) -> dict[str, np.ndarray]:
    with named_errors(path):
        data = read_bytes(path, at_most=2**50)  # However large the replays are.
        data, has = data[:-_DIGEST_SIZE], data[-_DIGEST_SIZE:]
        if has != digest(data):
            raise ValueError("its checksum is wrong")
        return from_npz(data)


def digest(data: bytes) -> bytes:
    """The checksum that stands behind a file's content."""
    return hashlib.blake2b(data, digest_size=_DIGEST_SIZE).digest()


def _to_bytes(text: str) -> np.ndarray:
    return np.frombuffer(text.encode(), np.uint8)


def _to_text(array: np.ndarray) -> bytes:
    """UTF-8, of an array of bytes."""
    if array.dtype != np.uint8 or array.ndim != 1:
        raise ValueError("a text in it is none")
    return array.tobytes()
