"""What is on disk: one folder for a sweep, and in it one folder for each finished run.

::

    OUT/config.json                          what defines the numbers, the command, the versions
    OUT/runs/<method>/seed-0003/run.json     the run: config, versions, commit, cost, digests
    OUT/runs/<method>/seed-0003/episodes.csv training episodes
    OUT/runs/<method>/seed-0003/test.csv     test episodes
    OUT/runs/<method>/seed-0003/progress.csv test episodes at earlier points of training
    OUT/runs/<method>/seed-0003/params.npz   the final parameters
    OUT/runs/<method>/seed-0003/episodes.npz recorded training episodes, to be played again
    OUT/partial/<method>-seed-0003.csv       training episodes of a run still under way
    OUT/under_way/                           runs under way (`hitl_jax.training.saved_run_store`)
    OUT/summary.csv, OUT/summary.md, OUT/figures/, OUT/replays/

Everything is written atomically (`atomic_files`), so a file or a run that is there is whole,
whenever the process is killed. A folder has one writer at a time (`atomic_files.locked`) and any
number of readers. Nothing here imports jax.
"""

import dataclasses
import json
import os
import pathlib
import tempfile
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hitl_jax.errors import ResultsError
from hitl_jax.results import recorded_episodes
from hitl_jax.results.atomic_files import (
    LOCK,
    TEMPORARY,
    named_errors,
    read_bytes,
    remove_leftovers,
    require_held,
    write_folder_atomic,
    write_text_atomic,
)
from hitl_jax.results.config_diff import changes, completed, require_same
from hitl_jax.results.episode_tables import (
    EPISODE_COLUMNS,
    MODES,
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
    Table,
    table_from_csv,
    table_to_csv,
    to_table,
)
from hitl_jax.results.json_documents import LARGEST_JSON, checked, digest_of, from_json, to_json
from hitl_jax.results.npz_archives import from_npz, to_npz
from hitl_jax.results.provenance import git_commit, versions
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_key import RunKey, parse_key, sort_keys
from hitl_jax.results.schemas import FolderDocument, KnownConfig, RunDocument

RUN_INFO = ("config", "versions", "commit", "wall_seconds", "env_steps", "updates")
"""What the caller of `save_run` tells about a run."""

RUN_FILES = ("episodes.csv", "test.csv", "progress.csv", "params.npz", "episodes.npz")
"""Of a run's folder beside run.json, which has the digest of each."""
_MAY_LACK = ("progress.csv", "episodes.npz")

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
        config = _as_on_the_disk(config)
        provenance = {"versions": versions(), "commit": git_commit()}
        if self.path.exists() and not self.path.is_dir():
            raise ResultsError(f"{self.path}: is a file, not a folder")
        require_held(self.path)
        with named_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path, prefix=TEMPORARY):
                pass  # a folder that cannot be written is noticed now, not after hours
            if (self.path / "config.json").exists():
                require_same(self.path, self.load_config(), config)
                require_same(self.path, {"shard": self.load_shard()}, {"shard": shard})
                remove_leftovers(self.path)
                return changes(self._document(), provenance)
            ours = (TEMPORARY, LOCK)
            foreign = [p.name for p in self.path.iterdir() if not p.name.startswith(ours)]
            if foreign:
                raise ResultsError(
                    f"{self.path}: holds other files ({min(foreign)}) and no config.json; "
                    "name a new or an empty folder"
                )
            remove_leftovers(self.path)
        part = {} if shard is None else {"shard": shard}
        # A folder's name may be no text.
        told = "".join(letter if letter.isprintable() else "?" for letter in command)
        document = {"config": config, "command": told} | part | provenance
        write_text_atomic(self.path / "config.json", to_json(document))
        return []

    def load_config(self) -> dict[str, Any]:
        """The config that the folder was made with, complete also where an earlier commit wrote it.

        Raises:
            ResultsError: if this is no results folder, or config.json is damaged.
        """
        return completed(self._document()["config"])

    def load_shard(self) -> dict[str, Any] | None:
        """Which part of a sweep the folder is for; None where it is for all of it.

        Raises:
            ResultsError: if config.json is damaged.
        """
        return self._document().get("shard")

    def _document(self) -> dict[str, Any]:
        """config.json, checked."""
        path = self.path / "config.json"
        if not path.exists():
            raise ResultsError(f"{self.path}: no results here (no config.json)")
        with named_errors(path):
            document = from_json(read_bytes(path, LARGEST_JSON), FolderDocument)
            checked(document["config"], KnownConfig)
        return document

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
        final = self.run_path(key)
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
        head = {"method": key.method, "seed": key.seed, "status": status}
        recorded = {
            f"{name}/{field}": getattr(kept, field)
            for name, kept in (recordings or {}).items()
            for field in Recording._fields
        }
        contents = {
            "episodes.csv": table_to_csv(to_table(episodes, EPISODE_COLUMNS)).encode(),
            "test.csv": table_to_csv(to_table(tests, TEST_COLUMNS)).encode(),
            "progress.csv": table_to_csv(to_table(progress or _NONE, PROGRESS_COLUMNS)).encode(),
            "params.npz": to_npz(params),
            "episodes.npz": to_npz(recorded, np.savez_compressed),
        }
        files = {name: digest_of(data) for name, data in contents.items()}
        document = head | info | head | {"files": files}  # Which `info` cannot change.
        write_folder_atomic(final, contents | {"run.json": to_json(document).encode()})

    def copy_run(self, source: "ResultsFolder", key: RunKey) -> None:
        """Copies a finished run from another folder, whole or not at all.

        Raises:
            ResultsError: if it is damaged there, is here already, or the disk refuses.
        """
        self._require_there()
        final, origin = self.run_path(key), source.run_path(key)
        if final.exists():
            raise ResultsError(f"{final}: this run is finished already")
        source.check_run(key)
        there = [name for name in ("run.json", *RUN_FILES) if os.path.lexists(origin / name)]
        contents = {name: read_bytes(origin / name, follow=False) for name in there}
        write_folder_atomic(final, contents)

    def check_run(self, key: RunKey) -> None:
        """Reads all that a run has.

        Raises:
            ResultsError: if a file is missing, damaged or a link, or the run is of another config.
        """
        for path in sorted(self.run_path(key).glob("*")):
            if path.is_symlink():
                raise ResultsError(f"{path}: is a link, no file of this run")
        self.load_params(key)
        self.load_recordings(key)

    def finished(self) -> set[RunKey]:
        """The runs that are on the disk, whole."""
        return {key for key in self._named() if (self.run_path(key) / "run.json").exists()}

    def _named(self) -> set[RunKey]:
        """The runs that have a folder, with a run in it or not."""
        paths = self.path.glob("runs/*/seed-*")
        return {key for p in paths if (key := parse_key(f"{p.parent.name}-{p.name}"))}

    def require_free(self, keys: Iterable[RunKey]) -> None:
        """Makes sure that runs that are still to be made can be written.

        Raises:
            ResultsError: if a folder of one of them is there, without a run in it.
        """
        finished = self.finished()
        for key in keys:
            if key not in finished and os.path.lexists(path := self.run_path(key)):
                raise ResultsError(f"{path}: is there and holds no finished run: remove it")

    def load_run(self, key: RunKey) -> Run:
        """Reads a finished run, without its parameters.

        Raises:
            ResultsError: if it is not there, a file is damaged, or it was made with another config
                than the folder.
        """
        info = self._load_info(key)
        run = Run(
            key,
            info,
            self._load_table(key, info, "episodes.csv", EPISODE_COLUMNS),
            self._load_table(key, info, "test.csv", TEST_COLUMNS),
            self._load_table(key, info, "progress.csv", PROGRESS_COLUMNS),
        )
        with named_errors(self.run_path(key)):
            _require_whole(run)
        return run

    def _load_info(self, key: RunKey) -> dict[str, Any]:
        """run.json, checked."""
        path = self.run_path(key) / "run.json"
        with named_errors(path):
            info = from_json(read_bytes(path, LARGEST_JSON), RunDocument)
            checked(info["config"], KnownConfig)
        if (info["method"], info["seed"]) != (key.method, key.seed):
            raise ResultsError(f"{path}: is of another run than its folder's name")
        require_same(path, completed(info["config"]), self.load_config())
        return info

    def _load_table(
        self, key: RunKey, info: dict[str, Any], name: str, columns: tuple[str, ...]
    ) -> Table:
        data = self._load_file(key, info, name)
        if data is None:
            return to_table(_NONE, columns)
        with named_errors(self.run_path(key) / name):
            return table_from_csv(data.decode(), columns)

    def _load_file(self, key: RunKey, info: dict[str, Any], name: str) -> bytes | None:
        """A file of a run; None of one that the run was made without."""
        path = self.run_path(key) / name
        digests = info.get("files", {})
        if name in _MAY_LACK and name not in digests and not path.exists():
            return None
        data = read_bytes(path)
        if digests and digests.get(name) != digest_of(data):
            raise ResultsError(f"{path}: damaged: is not the file that run.json names")
        return data

    def load_all(self) -> list[Run]:
        """All finished runs: in the order of `METHODS`, other methods after them, then by seed.

        Raises:
            ResultsError: if one is damaged, or lacks its run.json.
        """
        self.require_free(self._named() - self.finished())
        return [self.load_run(key) for key in sort_keys(self.finished())]

    def load_params(self, key: RunKey) -> dict[str, np.ndarray]:
        """The final parameters of a finished run, by flat name.

        Raises:
            ResultsError: if the file is missing or damaged.
        """
        data = self._load_file(key, self._load_info(key), "params.npz")
        assert data is not None
        with named_errors(self.run_path(key) / "params.npz"):
            return from_npz(data)

    def load_recordings(self, key: RunKey) -> dict[str, Recording]:
        """The recorded training episodes of a finished run, by name; none if it was made without.

        Raises:
            ResultsError: if the file is damaged.
        """
        run = self.load_run(key)
        data = self._load_file(key, run.info, "episodes.npz")
        if data is None:
            return {}
        action_size = run.info["config"].get("agent", {}).get("action_size")
        with named_errors(self.run_path(key) / "episodes.npz"):
            return recorded_episodes.from_npz(data, run.episodes["length"], action_size)

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
                with named_errors(path):
                    text = read_bytes(path).decode()
                    tables[key] = table_from_csv(text, EPISODE_COLUMNS)
            except ResultsError:
                if path.exists():  # if not, the run has finished since the folder was listed
                    raise
        return tables

    def _require_there(self) -> None:
        """Refuses to make anew what somebody has removed: it would lack all but the latest."""
        if not (self.path / "config.json").exists():
            raise ResultsError(f"{self.path}: has vanished, or its config.json has")

    def run_path(self, key: RunKey) -> pathlib.Path:
        """The folder of a run, there or not."""
        return self.path / "runs" / key.method / f"seed-{key.seed:04d}"

    def _partial_path(self, key: RunKey) -> pathlib.Path:
        return self.path / "partial" / f"{key.file_name}.csv"


def _as_on_the_disk(config: dict[str, Any]) -> dict[str, Any]:
    """A config with lists for tuples, and Python's numbers for NumPy's.

    Raises:
        ValueError: if it is not what a file may hold.
    """
    plain: dict[str, Any] = json.loads(to_json({"config": config}))["config"]
    return plain


def _require_whole(run: Run) -> None:
    """Refuses a run that has other numbers of episodes than its config says."""
    asked = run.info["config"]
    has = len(run.episodes["episode"])
    if has != asked.get("episodes", has):
        raise ValueError(f"has {has} training episodes: must be {asked['episodes']}")
    if run.diverged and run.info["diverged"]["episodes"] > has:
        raise ValueError(f"has {has} training episodes, and diverged after more")
    for mode in MODES:
        has = int((run.tests["mode"] == mode).sum())
        if has not in (0, asked.get("test_episodes", has)):
            raise ValueError(f"has {has} {mode} test episodes: must be {asked['test_episodes']}")
