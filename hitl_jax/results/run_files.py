"""Writes the content of a finished run's files, and reads and checks each of them.

A run's folder is `runs/<method>/seed-<seed>/` of a results folder; `ResultsFolder` writes and reads
whole runs with the functions here. Nothing here imports JAX.
"""

import dataclasses
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hitl_jax.errors import ResultsError
from hitl_jax.results import model_card
from hitl_jax.results.atomic_files import named_errors, read_bytes
from hitl_jax.results.diagnostic_table import FILE as DIAGNOSTICS
from hitl_jax.results.diagnostic_table import diagnostics_from_csv, diagnostics_to_csv
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
from hitl_jax.results.npz_archives import to_npz
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.results.schemas import KnownConfig, RunDocument

RUN_INFO = ("config", "versions", "commit", "wall_seconds", "env_steps", "updates")
"""The entries of run.json that the caller of `ResultsFolder.save_run` must give."""

RUN_FILES = ("episodes.csv", "test.csv", "progress.csv", "params.npz", "episodes.npz", DIAGNOSTICS)
"""The files of a run beside run.json, which has the digest of each."""
_OPTIONAL_FILES = ("progress.csv", "episodes.npz", DIAGNOSTICS)
"""Earlier versions of this program wrote runs without these."""

_NO_PROGRESS: dict[str, Any] = {name: [] for name in PROGRESS_COLUMNS}


@dataclasses.dataclass(frozen=True)
class Run:
    """A finished run, without its parameters.

    Attributes:
        key: method and seed.
        info: the content of run.json.
        episodes: training episodes, columns `EPISODE_COLUMNS`, each [T].
        tests: test episodes, columns `TEST_COLUMNS`, each [N].
        progress: test episodes at earlier points of training, columns `PROGRESS_COLUMNS`; empty if
            the run was made without them.
        diagnostics: samples of the run's learners, see `diagnostic_table`; no rows if there were
            none, and no columns if the run was made without them.
    """

    key: RunKey
    info: dict[str, Any]
    episodes: Table
    tests: Table
    progress: Table = dataclasses.field(
        default_factory=lambda: to_table(_NO_PROGRESS, PROGRESS_COLUMNS)
    )
    diagnostics: Table = dataclasses.field(default_factory=dict)

    @property
    def diverged(self) -> bool:
        """Whether a number of the run became non-finite; episodes after that count as falls."""
        return bool(self.info.get("diverged"))

    @property
    def lost_tests(self) -> int:
        """Number of test episodes that count as falls because a number was not finite."""
        return self.info.get("lost_tests", 0)

    @property
    def played(self) -> Table:
        """The training episodes that were played: of a diverged run those before it diverged."""
        end = self.info["diverged"]["episodes"] if self.diverged else None
        return {name: values[:end] for name, values in self.episodes.items()}


def run_contents(
    key: RunKey,
    episodes: dict[str, Any],
    tests: dict[str, Any],
    params: dict[str, np.ndarray],
    info: dict[str, Any],
    progress: dict[str, Any] | None,
    recordings: Mapping[str, Recording] | None,
    diagnostics: Sequence[Mapping[str, Any]],
) -> dict[str, bytes]:
    """The files of a run, bytes by name; the arguments are those of `ResultsFolder.save_run`.

    Raises:
        ValueError: if a column, an array or an entry of `info` is not what it must be.
    """
    missing = [name for name in RUN_INFO if name not in info]
    if missing:
        raise ValueError(f"info lacks {', '.join(missing)}")
    objects = [name for name, array in params.items() if np.asarray(array).dtype.hasobject]
    if objects:
        raise ValueError(f"parameter {objects[0]!r} is not an array of numbers")
    status = "diverged" if info.get("diverged") else "finished"
    head = {"method": key.method, "seed": key.seed, "status": status}
    recorded = {
        f"{name}/{field}": getattr(recording, field)
        for name, recording in (recordings or {}).items()
        for field in Recording._fields
    }
    contents = {
        "episodes.csv": table_to_csv(to_table(episodes, EPISODE_COLUMNS)).encode(),
        "test.csv": table_to_csv(to_table(tests, TEST_COLUMNS)).encode(),
        "progress.csv": table_to_csv(to_table(progress or _NO_PROGRESS, PROGRESS_COLUMNS)).encode(),
        "params.npz": to_npz(params),
        "episodes.npz": to_npz(recorded, np.savez_compressed),
        DIAGNOSTICS: diagnostics_to_csv(diagnostics).encode(),
    }
    files = {name: digest_of(data) for name, data in contents.items()}
    document = head | info | head | {"files": files}  # `info` cannot replace these.
    tables = to_table(episodes, EPISODE_COLUMNS), to_table(tests, TEST_COLUMNS)
    card = model_card.model_card(key, document, *tables)
    return contents | {
        "run.json": to_json(document).encode(),
        model_card.FILE: card.encode(),
    }


def copied_contents(path: pathlib.Path, run: Run) -> dict[str, bytes]:
    """The files of a run that is copied, bytes by name; its card is written anew.

    Args:
        path: the run's folder.
        run: what is in it, checked.

    Raises:
        ResultsError: if a file cannot be read, or is a link.
    """
    names = [name for name in ("run.json", *RUN_FILES) if os.path.lexists(path / name)]
    card = model_card.model_card(run.key, run.info, run.episodes, run.tests)
    contents = {name: read_bytes(path / name, follow=False) for name in names}
    return contents | {model_card.FILE: card.encode()}


def read_info(path: pathlib.Path, key: RunKey) -> dict[str, Any]:
    """Reads and checks run.json.

    Args:
        path: the run's folder.
        key: the run that its folder's name says.

    Raises:
        ResultsError: if it is missing or damaged, or is of another run.
    """
    path = path / "run.json"
    with named_errors(path):
        info = from_json(read_bytes(path, LARGEST_JSON), RunDocument)
        checked(info["config"], KnownConfig)
    if (info["method"], info["seed"]) != (key.method, key.seed):
        raise ResultsError(f"{path}: is of another run than its folder's name")
    return info


def read_table(
    path: pathlib.Path, info: dict[str, Any], name: str, columns: tuple[str, ...]
) -> Table:
    """Reads a table of a run; an optional one that is missing is empty.

    Args:
        path: the run's folder.
        info: its run.json.
        name: of the file.
        columns: of the table.

    Raises:
        ResultsError: if it is missing or damaged.
    """
    data = read_file(path, info, name)
    if data is None:
        return to_table(_NO_PROGRESS, columns)
    with named_errors(path / name):
        return table_from_csv(data.decode(), columns)


def read_diagnostics(path: pathlib.Path, info: dict[str, Any]) -> Table:
    """Reads the samples of a run's learners; no columns if the run was made without them.

    Args:
        path: the run's folder.
        info: its run.json.

    Raises:
        ResultsError: if the file is damaged.
    """
    data = read_file(path, info, DIAGNOSTICS)
    with named_errors(path / DIAGNOSTICS):
        return diagnostics_from_csv((data or b"").decode())


def read_file(path: pathlib.Path, info: dict[str, Any], name: str) -> bytes | None:
    """Reads a file of a run and checks its digest; None for an optional one that is missing.

    Args:
        path: the run's folder.
        info: its run.json.
        name: of the file.

    Raises:
        ResultsError: if it is missing, or is not the file that run.json names.
    """
    digests = info.get("files", {})
    path = path / name
    if name in _OPTIONAL_FILES and name not in digests and not path.exists():
        return None
    data = read_bytes(path)
    if digests and digests.get(name) != digest_of(data):
        raise ResultsError(f"{path}: damaged: is not the file that run.json names")
    return data


def require_whole(run: Run) -> None:
    """Checks that a run has as many episodes as its config says.

    Raises:
        ValueError: if it has another number.
    """
    asked = run.info["config"]
    has = len(run.episodes["episode"])
    if has != asked.get("episodes", has):
        raise ValueError(f"has {has} training episodes: must be {asked['episodes']}")
    if run.diverged and run.info["diverged"]["episodes"] > has:
        raise ValueError(f"has {has} training episodes, and diverged after more")
    if (run.progress["trained"] > has).any():
        raise ValueError(f"has {has} training episodes, and was tested during training after more")
    for mode in MODES:
        has = int((run.tests["mode"] == mode).sum())
        if has not in (0, asked.get("test_episodes", has)):
            raise ValueError(f"has {has} {mode} test episodes: must be {asked['test_episodes']}")
