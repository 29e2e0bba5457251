"""What is on disk: one folder for a sweep, and in it one folder for each finished run.

::

    OUT/config.json                          what defines the numbers, the command, the versions
    OUT/runs/<method>/seed-0003/run.json     the run: config, versions, commit, cost
    OUT/runs/<method>/seed-0003/episodes.csv training episodes
    OUT/runs/<method>/seed-0003/test.csv     test episodes
    OUT/runs/<method>/seed-0003/progress.csv test episodes at earlier points of training
    OUT/runs/<method>/seed-0003/params.npz   the final parameters
    OUT/runs/<method>/seed-0003/episodes.npz recorded training episodes, to be played again
    OUT/partial/<method>-seed-0003.csv       training episodes of a run still under way
    OUT/under_way/                           runs under way (`hitl_jax.saves`)
    OUT/summary.csv, OUT/summary.md, OUT/figures/, OUT/replays/

Everything is written atomically (`hitl_jax.files`), so a file or a run that is there is whole,
whenever the process is killed. A folder has one writer at a time (`hitl_jax.files.locked`) and any
number of readers. Nothing here imports jax.
"""

import dataclasses
import io
import json
import os
import pathlib
import tempfile
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hitl_jax.differences import changes, completed, require_same
from hitl_jax.files import (
    LOCK,
    TEMPORARY,
    ResultsError,
    named_errors,
    remove_leftovers,
    require_held,
    write_folder_atomic,
    write_text_atomic,
)
from hitl_jax.provenance import git_commit, versions
from hitl_jax.recording import Recording
from hitl_jax.run_key import RunKey, parse_key, sort_keys
from hitl_jax.tables import (
    EPISODE_COLUMNS,
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
    Table,
    table_from_csv,
    table_to_csv,
    to_table,
)

FORMAT = 1
RUN_INFO = ("config", "versions", "commit", "wall_seconds", "env_steps", "updates")
"""What the caller of `save_run` tells about a run."""

_NONE: dict[str, Any] = {name: [] for name in PROGRESS_COLUMNS}


@dataclasses.dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes:
        key: its name.
        info: run.json.
        episodes: training episodes, columns `EPISODE_COLUMNS`.
        tests: test episodes, columns `TEST_COLUMNS`.
        progress: test episodes at earlier points of training, columns `PROGRESS_COLUMNS`; none of
            a run that was made without.
    """

    key: RunKey
    info: dict[str, Any]
    episodes: Table
    tests: Table
    progress: Table = dataclasses.field(default_factory=lambda: to_table(_NONE, PROGRESS_COLUMNS))

    @property
    def diverged(self) -> bool:
        """Whether its numbers turned not finite; what it could not play counts as falls."""
        return bool(self.info.get("diverged"))

    @property
    def lost_tests(self) -> int:
        """Test episodes that count as falls since a number was not finite."""
        return self.info.get("lost_tests", 0)

    @property
    def played(self) -> Table:
        """The training episodes that were played, without those that a diverged run could not."""
        end = self.info["diverged"]["episodes"] if self.diverged else None
        return {name: values[:end] for name, values in self.episodes.items()}


class ResultsFolder:
    """One folder of results. Making the object touches nothing on the disk.

    Args:
        path: the folder, there or not.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = pathlib.Path(path)

    def create_or_resume(
        self, config: dict[str, Any], command: str, shard: dict[str, Any] | None = None
    ) -> list[str]:
        """Makes the folder, or makes sure that it holds results of the same config.

        On resuming, config.json keeps the first command and versions (each run.json has its own),
        and what a killed process left half written is removed.

        Args:
            config: all that defines the numbers: a nested dict of what JSON can hold, no NaN.
            command: the command line, for the record.
            shard: which part of a sweep the folder is for, if it is not for all of it.

        Returns:
            What of commit and versions is not as it was when the folder was made.

        Raises:
            ConfigMismatch: if the folder was made with another config, or for another shard.
            ResultsError: if the folder holds something else, or cannot be written.
        """
        config = json.loads(_to_json(config))  # tuples become lists, as on the disk
        provenance = {"versions": versions(), "commit": git_commit()}
        if self.path.exists() and not self.path.is_dir():
            raise ResultsError(f"{self.path}: is a file, not a folder")
        with named_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path, prefix=TEMPORARY):
                pass  # a folder that cannot be written is noticed now, not after hours
            if (self.path / "config.json").exists():
                require_same(self.path, self.load_config(), config)
                require_same(self.path, {"shard": self.load_shard()}, {"shard": shard})
                remove_leftovers(self.path)
                return changes(_read_json(self.path / "config.json", ()), provenance)
            ours = (TEMPORARY, LOCK)
            foreign = [p.name for p in self.path.iterdir() if not p.name.startswith(ours)]
            if foreign:
                raise ResultsError(
                    f"{self.path}: holds other files ({min(foreign)}) and no config.json; "
                    "name a new or an empty folder"
                )
            remove_leftovers(self.path)
        part = {} if shard is None else {"shard": shard}
        document = {"format": FORMAT, "config": config, "command": command} | part | provenance
        write_text_atomic(self.path / "config.json", _to_json(document))
        return []

    def load_config(self) -> dict[str, Any]:
        """The config that the folder was made with, complete also where an earlier commit wrote it.

        Raises:
            ResultsError: if this is no results folder, or config.json is damaged.
        """
        path = self.path / "config.json"
        if not path.exists():
            raise ResultsError(f"{self.path}: no results here (no config.json)")
        return completed(_read_json(path, ("config",))["config"])

    def load_shard(self) -> dict[str, Any] | None:
        """Which part of a sweep the folder is for; None where it is for all of it.

        Raises:
            ResultsError: if config.json is damaged.
        """
        return _read_json(self.path / "config.json", ("config",)).get("shard")

    def save_run(
        self,
        key: RunKey,
        episodes: dict[str, Any],
        tests: dict[str, Any],
        params: dict[str, np.ndarray],
        info: dict[str, Any],
        progress: dict[str, Any] | None = None,
        recordings: Mapping[str, Recording] | None = None,
    ) -> None:
        """Writes a finished run, whole or not at all.

        Args:
            key: the run.
            episodes: training episodes, columns `EPISODE_COLUMNS`, each [T].
            tests: test episodes, columns `TEST_COLUMNS`, each [N]; N may be 0.
            params: arrays by flat name, for example "actor/params/Dense_0/kernel".
            info: what `RUN_INFO` lists, and whatever else JSON can hold; `diverged` says where the
                run's numbers turned not finite, if they did.
            progress: test episodes at earlier points of training, columns `PROGRESS_COLUMNS`.
            recordings: training episodes to be played again, by name.

        Raises:
            ResultsError: if the run is there already, or the disk refuses.
            ValueError: if a column, an array or an entry of `info` is not what it must be.
        """
        final = self._run_path(key)
        self._require_there()
        if final.exists():
            raise ResultsError(f"{final}: this run is finished already")
        missing = [name for name in RUN_INFO if name not in info]
        if missing:
            raise ValueError(f"info lacks {', '.join(missing)}")
        objects = [name for name, array in params.items() if np.asarray(array).dtype.hasobject]
        if objects:
            raise ValueError(f"parameter {objects[0]!r} is not an array of numbers")
        status = "diverged" if info.get("diverged") else "finished"
        head = {"format": FORMAT, "method": key.method, "seed": key.seed, "status": status}
        document = head | info | head  # `head` comes first, and `info` cannot change it
        recorded = {
            f"{name}/{field}": getattr(kept, field)
            for name, kept in (recordings or {}).items()
            for field in Recording._fields
        }
        contents = {
            "episodes.csv": table_to_csv(to_table(episodes, EPISODE_COLUMNS)).encode(),
            "test.csv": table_to_csv(to_table(tests, TEST_COLUMNS)).encode(),
            "progress.csv": table_to_csv(to_table(progress or _NONE, PROGRESS_COLUMNS)).encode(),
            "params.npz": _to_npz(params, np.savez),
            "episodes.npz": _to_npz(recorded, np.savez_compressed),
            "run.json": _to_json(document).encode(),
        }
        write_folder_atomic(final, contents)

    def copy_run(self, source: "ResultsFolder", key: RunKey) -> None:
        """Copies a finished run from another folder, whole or not at all.

        Raises:
            ResultsError: if it is damaged there, is here already, or the disk refuses.
        """
        self._require_there()
        final, origin = self._run_path(key), source._run_path(key)
        if final.exists():
            raise ResultsError(f"{final}: this run is finished already")
        source.load_run(key)
        with named_errors(origin):
            contents = {path.name: path.read_bytes() for path in sorted(origin.iterdir())}
        write_folder_atomic(final, contents)

    def finished(self) -> set[RunKey]:
        """The runs that are on the disk, whole."""
        names = [(path.parent.name, path.name) for path in self.path.glob("runs/*/seed-*")]
        return {key for method, name in names if (key := parse_key(f"{method}-{name}"))}

    def load_run(self, key: RunKey) -> Run:
        """Reads a finished run, without its parameters.

        Raises:
            ResultsError: if it is not there or a file is damaged.
        """
        folder = self._run_path(key)
        info = _read_json(folder / "run.json", RUN_INFO)
        if (info.get("method"), info.get("seed")) != (key.method, key.seed):
            raise ResultsError(f"{folder / 'run.json'}: is of another run than its folder's name")
        self._require_own(folder / "run.json", info)
        episodes = _read_table(folder / "episodes.csv", EPISODE_COLUMNS)
        tests = _read_table(folder / "test.csv", TEST_COLUMNS)
        if not (folder / "progress.csv").exists():
            return Run(key, info, episodes, tests)
        return Run(
            key, info, episodes, tests, _read_table(folder / "progress.csv", PROGRESS_COLUMNS)
        )

    def _require_own(self, path: pathlib.Path, info: dict[str, Any]) -> None:
        """Refuses a run that was made with another config than the folder's."""
        if not isinstance(info["config"], dict):
            raise ResultsError(f"{path}: damaged: its config is no object")
        require_same(path, completed(info["config"]), self.load_config())

    def load_all(self) -> list[Run]:
        """All finished runs: in the order of `METHODS`, other methods after them, then by seed."""
        return [self.load_run(key) for key in sort_keys(self.finished())]

    def load_params(self, key: RunKey) -> dict[str, np.ndarray]:
        """The final parameters of a finished run, by flat name.

        Raises:
            ResultsError: if the file is missing or damaged.
        """
        return _read_npz(self._run_path(key) / "params.npz")

    def load_recordings(self, key: RunKey) -> dict[str, Recording]:
        """The recorded training episodes of a finished run, by name; none if it was made without.

        Raises:
            ResultsError: if the file is damaged.
        """
        path = self._run_path(key) / "episodes.npz"
        if not path.exists():
            return {}
        with named_errors(path):
            arrays = _read_npz(path)
            names = [name.removesuffix("/episode") for name in arrays if name.endswith("/episode")]
            try:
                return {
                    name: Recording(int(arrays[f"{name}/episode"]), arrays[f"{name}/steps"])
                    for name in names
                }
            except (KeyError, TypeError) as error:
                raise ValueError(f"is not of this program: {error!r}") from error

    def write_partial(self, key: RunKey, episodes: dict[str, Any]) -> None:
        """Writes, in place of an earlier one, the training episodes so far of a run under way."""
        self._require_there()
        text = table_to_csv(to_table(episodes, EPISODE_COLUMNS))
        write_text_atomic(self._partial_path(key), text)

    def remove_partial(self, key: RunKey) -> None:
        """Removes a run's partial episodes, if there are any."""
        require_held(self.path)
        with named_errors(self._partial_path(key)):
            self._partial_path(key).unlink(missing_ok=True)

    def load_partials(self) -> dict[RunKey, Table]:
        """The training episodes so far of the runs that are not finished.

        Raises:
            ResultsError: if a file is damaged.
        """
        keys = {key for p in self.path.glob("partial/*.csv") if (key := parse_key(p.stem))}
        tables = {}
        # A process killed between `save_run` and `remove_partial` leaves both.
        for key in sort_keys(keys - self.finished()):
            path = self._partial_path(key)
            try:
                tables[key] = _read_table(path, EPISODE_COLUMNS)
            except ResultsError:
                if path.exists():  # if not, the run has finished since the folder was listed
                    raise
        return tables

    def _require_there(self) -> None:
        """Refuses to make anew what somebody has removed: it would lack all but the latest."""
        if not (self.path / "config.json").exists():
            raise ResultsError(f"{self.path}: has vanished, or its config.json has")

    def _run_path(self, key: RunKey) -> pathlib.Path:
        return self.path / "runs" / key.method / f"seed-{key.seed:04d}"

    def _partial_path(self, key: RunKey) -> pathlib.Path:
        return self.path / "partial" / f"{key.file_name}.csv"


def _to_json(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2, allow_nan=False, default=_plain) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} cannot be written as JSON")


def _read_json(path: pathlib.Path, required: tuple[str, ...]) -> dict[str, Any]:
    with named_errors(path):
        document = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise ResultsError(f"{path}: is not of format {FORMAT} of this program")
        missing = [name for name in required if name not in document]
        if missing:
            raise ValueError(f"lacks {', '.join(missing)}")
    return document


def _to_npz(arrays: Mapping[str, Any], save: Callable[..., None]) -> bytes:
    archive = io.BytesIO()
    save(archive, **arrays)
    return archive.getvalue()


def _read_npz(path: pathlib.Path) -> dict[str, np.ndarray]:
    # Opened here: np.load leaves the file open where the archive is damaged.
    with named_errors(path), open(path, "rb") as file:
        try:
            archive = np.load(file, allow_pickle=False)
            return {name: archive[name] for name in archive.files}
        except OSError:
            raise
        except Exception as error:  # A flipped bit can make of zipfile's and NumPy's errors any.
            raise ValueError(f"{type(error).__name__}: {error}") from error


def _read_table(path: pathlib.Path, names: tuple[str, ...]) -> Table:
    with named_errors(path):
        return table_from_csv(path.read_text(encoding="utf-8"), names)
