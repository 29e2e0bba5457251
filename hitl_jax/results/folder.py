"""`ResultsFolder`: one folder for a sweep on disk, and in it one folder for each finished run.

::

    OUT/config.json                          the config, the command line, the versions
    OUT/runs/<method>/seed-0003/run.json     the run: config, versions, commit, cost, digests
    OUT/runs/<method>/seed-0003/episodes.csv training episodes
    OUT/runs/<method>/seed-0003/test.csv     test episodes
    OUT/runs/<method>/seed-0003/progress.csv test episodes at earlier points of training
    OUT/runs/<method>/seed-0003/params.npz   the final parameters
    OUT/runs/<method>/seed-0003/episodes.npz recorded training episodes, to replay
    OUT/runs/<method>/seed-0003/diagnostics.csv losses, values and gradients, now and then
    OUT/runs/<method>/seed-0003/README.md    a model card
    OUT/partial/<method>-seed-0003.csv       training episodes of a run still under way
    OUT/under_way/                           saved runs (`training.saved_run_store`)
    OUT/summary.csv, OUT/summary.md, OUT/figures/, OUT/replays/

Everything is written atomically (`atomic_files`), by one process at a time (`atomic_files.locked`).
"""

import os
import pathlib
import tempfile
from collections.abc import Iterable, Mapping, Sequence
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
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
    Table,
    table_from_csv,
    table_to_csv,
    to_table,
)
from hitl_jax.results.json_documents import (
    LARGEST_JSON,
    as_in_json,
    checked,
    from_json,
    to_json,
)
from hitl_jax.results.npz_archives import from_npz
from hitl_jax.results.provenance import git_commit, versions
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_files import (
    Run,
    copied_contents,
    read_diagnostics,
    read_file,
    read_info,
    read_table,
    require_whole,
    run_contents,
)
from hitl_jax.results.run_key import RunKey, parse_key, sort_keys
from hitl_jax.results.schemas import FolderDocument, KnownConfig

__all__ = ["ResultsFolder", "Run"]


class ResultsFolder:
    """One folder of results. Making the object touches nothing on the disk.

    Args:
        path: the folder, whether it exists or not.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = pathlib.Path(path)

    def create_or_resume(
        self, config: dict[str, Any], command: str, shard: dict[str, Any] | None = None
    ) -> list[str]:
        """Makes the folder, or checks that an existing one has the same config.

        An existing config.json keeps its command and versions (each run.json has its own), and
        temporary files of killed processes are removed.

        Args:
            config: all that decides the results' numbers: a nested dict of JSON values, no NaN.
            command: the command line, for the record.
            shard: the part of a sweep that the folder is for; None for a whole sweep.

        Returns:
            One line for each difference of commit and versions since the folder was made.

        Raises:
            ConfigMismatch: if the folder was made with another config, or for another shard.
            ResultsError: if the folder holds something else, or cannot be written.
        """
        config = as_in_json(config)
        provenance = {"versions": versions(), "commit": git_commit()}
        if self.path.exists() and not self.path.is_dir():
            raise ResultsError(f"{self.path}: is a file, not a folder")
        require_held(self.path)
        with named_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path, prefix=TEMPORARY):
                pass  # A folder that cannot be written is noticed now, not after hours.
            if (self.path / "config.json").exists():
                require_same(self.path, self.load_config(), config)
                require_same(self.path, {"shard": self.load_shard()}, {"shard": shard})
                remove_leftovers(self.path)
                return changes(self.load_document(), provenance)
            ours = (TEMPORARY, LOCK)
            foreign = [p.name for p in self.path.iterdir() if not p.name.startswith(ours)]
            if foreign:
                what = f"holds other files ({min(foreign)}) and no config.json"
                raise ResultsError(f"{self.path}: {what}; name a new or an empty folder")
            remove_leftovers(self.path)
        part = {} if shard is None else {"shard": shard}
        # A folder's name in the command may hold bytes that are no text.
        printable = "".join(letter if letter.isprintable() else "?" for letter in command)
        document = {"config": config, "command": printable} | part | provenance
        write_text_atomic(self.path / "config.json", to_json(document))
        return []

    def load_config(self) -> dict[str, Any]:
        """The config of the folder; entries that earlier versions did not write get their defaults.

        Raises:
            ResultsError: if this is no results folder, or config.json is damaged.
        """
        return completed(self.load_document()["config"])

    def load_shard(self) -> dict[str, Any] | None:
        """The part of a sweep that the folder is for; None for a whole sweep.

        Raises:
            ResultsError: if config.json is damaged.
        """
        return self.load_document().get("shard")

    def load_document(self) -> dict[str, Any]:
        """Reads and checks config.json."""
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
        diagnostics: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        """Writes a finished run, whole or not at all.

        Args:
            key: the run.
            episodes: training episodes, columns `EPISODE_COLUMNS`, each [T].
            tests: test episodes, columns `TEST_COLUMNS`, each [N]; N may be 0.
            params: arrays by flat name, for example "actor/params/Dense_0/kernel".
            info: the entries of `run_files.RUN_INFO`, and other JSON values; `diverged` says where
                a number of the run became non-finite, if one did.
            progress: test episodes at earlier points of training, columns `PROGRESS_COLUMNS`.
            recordings: recorded training episodes, by name.
            diagnostics: samples of its learners, a row each; see `diagnostic_table`.

        Raises:
            ResultsError: if the run exists already, or cannot be written.
            ValueError: if a column, an array or an entry of `info` is not what it must be.
        """
        final = self.run_path(key)
        self._require_exists()
        if final.exists():
            raise ResultsError(f"{final}: this run is finished already")
        contents = run_contents(
            key, episodes, tests, params, info, progress, recordings, diagnostics
        )
        write_folder_atomic(final, contents)

    def copy_run(self, source: "ResultsFolder", key: RunKey) -> None:
        """Copies a finished run from another folder, whole or not at all.

        Raises:
            ResultsError: if it is damaged there, exists here already, or cannot be written.
        """
        self._require_exists()
        final = self.run_path(key)
        if final.exists():
            raise ResultsError(f"{final}: this run is finished already")
        source.check_run(key)
        write_folder_atomic(final, copied_contents(source.run_path(key), source.load_run(key)))

    def check_run(self, key: RunKey) -> None:
        """Checks all files of a run.

        Raises:
            ResultsError: if a file is missing, damaged or a link, or the run has another config.
        """
        for path in sorted(self.run_path(key).glob("*")):
            if path.is_symlink():
                raise ResultsError(f"{path}: is a link, no file of this run")
        self.load_params(key)
        self.load_recordings(key)

    def finished(self) -> set[RunKey]:
        """The finished runs of the folder."""
        return {key for key in self._with_folder() if (self.run_path(key) / "run.json").exists()}

    def _with_folder(self) -> set[RunKey]:
        """The runs whose folder exists, whether it holds a finished run or not."""
        paths = self.path.glob("runs/*/seed-*")
        return {key for p in paths if (key := parse_key(f"{p.parent.name}-{p.name}"))}

    def require_free(self, keys: Iterable[RunKey]) -> None:
        """Checks that unfinished runs can be written.

        Args:
            keys: runs that the caller wants to make or has made.

        Raises:
            ResultsError: if the folder of an unfinished one exists.
        """
        finished = self.finished()
        for key in keys:
            if key not in finished and os.path.lexists(path := self.run_path(key)):
                raise ResultsError(f"{path}: is there and holds no finished run: remove it")

    def load_run(self, key: RunKey) -> Run:
        """Reads a finished run, without its parameters.

        Raises:
            ResultsError: if a file is missing or damaged, or its config is not the folder's.
        """
        path, info = self.run_path(key), self._load_info(key)
        run = Run(
            key,
            info,
            read_table(path, info, "episodes.csv", EPISODE_COLUMNS),
            read_table(path, info, "test.csv", TEST_COLUMNS),
            read_table(path, info, "progress.csv", PROGRESS_COLUMNS),
            read_diagnostics(path, info),
        )
        with named_errors(path):
            require_whole(run)
        return run

    def _load_info(self, key: RunKey) -> dict[str, Any]:
        """Reads and checks run.json, also that its config is the folder's."""
        path = self.run_path(key)
        info = read_info(path, key)
        require_same(path / "run.json", completed(info["config"]), self.load_config())
        return info

    def load_all(self) -> list[Run]:
        """Reads all finished runs, by method (those of `METHODS` first), then by seed.

        Raises:
            ResultsError: if one is damaged, or a run's folder has no run.json.
        """
        self.require_free(self._with_folder() - self.finished())
        return [self.load_run(key) for key in sort_keys(self.finished())]

    def load_params(self, key: RunKey) -> dict[str, np.ndarray]:
        """The final parameters of a finished run, by flat name.

        Raises:
            ResultsError: if the file is missing or damaged.
        """
        path, info = self.run_path(key), self._load_info(key)
        data = read_file(path, info, "params.npz")
        assert data is not None
        with named_errors(path / "params.npz"):
            return from_npz(data)

    def load_recordings(self, key: RunKey) -> dict[str, Recording]:
        """The recorded training episodes of a finished run, by name; empty if it has none.

        Raises:
            ResultsError: if the file is damaged.
        """
        run = self.load_run(key)
        path = self.run_path(key)
        data = read_file(path, run.info, "episodes.npz")
        if data is None:
            return {}
        action_size = run.info["config"].get("agent", {}).get("action_size")
        with named_errors(path / "episodes.npz"):
            return recorded_episodes.from_npz(data, run.episodes["length"], action_size)

    def write_partial(self, key: RunKey, episodes: dict[str, Any]) -> None:
        """Writes the training episodes so far of a run under way, and replaces earlier ones."""
        self._require_exists()
        text = table_to_csv(to_table(episodes, EPISODE_COLUMNS))
        write_text_atomic(self._partial_path(key), text)

    def remove_partial(self, key: RunKey) -> None:
        """Removes a run's partial episodes, if it has any."""
        require_held(self.path)
        with named_errors(self._partial_path(key)):
            self._partial_path(key).unlink(missing_ok=True)

    def load_partials(self) -> dict[RunKey, Table]:
        """The training episodes so far of the unfinished runs.

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
                if path.exists():  # Else the run has finished since the folder was listed.
                    raise
        return tables

    def _require_exists(self) -> None:
        """Raises if the folder was removed: a new one would hold the latest run alone."""
        if not (self.path / "config.json").exists():
            raise ResultsError(f"{self.path}: has vanished, or its config.json has")

    def run_path(self, key: RunKey) -> pathlib.Path:
        """The path of a run's folder, whether it exists or not."""
        return self.path / "runs" / key.method / f"seed-{key.seed:04d}"

    def _partial_path(self, key: RunKey) -> pathlib.Path:
        return self.path / "partial" / f"{key.file_name}.csv"
