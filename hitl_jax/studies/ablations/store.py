"""What ablations have measured: one CSV, a line a run, whole whenever the process is killed."""

import dataclasses
import hashlib
import json
import pathlib
import re
from typing import Any

from hitl_jax.analysis.summary import SUMMARY_COLUMNS
from hitl_jax.choices.checks import MOST_SEED
from hitl_jax.results.atomic_files import named_errors, read_bytes, write_text_atomic
from hitl_jax.results.config_diff import CAME_LATER, without_later
from hitl_jax.results.episode_tables import cells_from_csv, finite, rows_to_csv
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.changes import Parts
from hitl_jax.sweep.train_and_test import policy_digest

Row = dict[str, Any]
"""One run; measures are float, or None where there is no value."""

LATE = (
    "settled_boundary",
    "late_intervened",
    "late_return_with",
    "late_return_without",
    "late_steps_with",
    "late_steps_without",
)
"""Measures of the end of training."""
AREA = "test_area"
"""The area under the tests along training."""
FALLS = "train_falls"
"""Training episodes that end in a fall."""
_ADDED = (*LATE, AREA, FALLS)
"""Files of earlier commits lack the last of these."""

_MEASURES = (*(name for name in SUMMARY_COLUMNS if name not in ("method", "seed")), *_ADDED)
_COLUMNS = ("setting", "method", "seed", "digest", "commit", *_MEASURES)


@dataclasses.dataclass(frozen=True)
class RunId:
    """Which run a line is of.

    Attributes:
        setting: `Setting.name`; two of one digest are one.
        method: which method.
        seed: which seed.
        digest: of all that defines the numbers, the defaults and the budget included.
    """

    setting: str = dataclasses.field(compare=False)
    method: str
    seed: int
    digest: str

    @property
    def key(self) -> RunKey:
        """Its name among runs that are trained side by side."""
        return RunKey(self.method, self.seed, self.digest)


def digest(parts: Parts, budget: dict[str, int]) -> str:
    """Twelve digits that differ when options or budget do.

    A choice that came later counts only where it changes something.
    """
    options = []
    for name in ("agent", "loop", "hyper"):
        values = dataclasses.asdict(getattr(parts, name))
        options.append(without_later(values, CAME_LATER.get(name, {})))
    asked = [*options, policy_digest(parts.human_policy), budget]
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:12]


class Store:
    """The runs of a file. Lines of other defaults or budgets stay in it, and are not looked at.

    Args:
        path: the file, there or not; it has one writer.
    """

    def __init__(self, path: pathlib.Path):
        self.path = path
        self._rows = _read(path)

    def __contains__(self, run: RunId) -> bool:
        return run in self._rows

    def __getitem__(self, run: RunId) -> Row:
        return self._rows[run]

    def keys(self) -> set[RunKey]:
        """The names of all its runs."""
        return {run.key for run in self._rows}

    def add(self, run: RunId, row: Row) -> None:
        """Adds a run, and writes the file.

        Raises:
            ResultsError: if it cannot be written.
        """
        self._rows |= {run: row}
        self.write()

    def write(self) -> None:
        """Writes the file."""
        ids = sorted(self._rows, key=dataclasses.astuple)
        rows = (dataclasses.asdict(run) | _plain(self._rows[run]) for run in ids)
        write_text_atomic(self.path, rows_to_csv(rows, _COLUMNS))


def _plain(row: Row) -> Row:
    """Whole numbers without a point, so that what is read back is written as it was."""
    whole = {name: int(x) for name, x in row.items() if isinstance(x, float) and x.is_integer()}
    return row | whole


def _read(path: pathlib.Path) -> dict[RunId, Row]:
    if not path.exists():
        return {}
    with named_errors(path):
        text = read_bytes(path).decode()
        has = len(text.partition("\n")[0].split(","))
        cells = cells_from_csv(text, _COLUMNS[: max(has, len(_COLUMNS) - len(_ADDED))])
        rows = [
            _parse(dict(zip(cells, row, strict=True))) for row in zip(*cells.values(), strict=True)
        ]
        if len(runs := dict(rows)) < len(rows):
            raise ValueError("a run is there twice")
    return runs


def _parse(line: dict[str, str]) -> tuple[RunId, Row]:
    seed = line["seed"]
    if not seed.isdecimal() or int(seed) > MOST_SEED or not line["setting"].isprintable():
        raise ValueError(f"setting {line['setting'][:50]!r} seed {seed[:20]!r}: is no run's name")
    run = RunId(line["setting"], line["method"], int(seed), line["digest"])
    _ = run.key  # Refuses what is no method or no digest.
    if not re.fullmatch(r"[0-9a-z+-]+", line["commit"]):
        raise ValueError(f"commit {line['commit'][:50]!r}: is none")
    measures = {
        name: finite(name, [line[name]], True).item() if line.get(name) else None
        for name in _MEASURES
    }
    if measures["diverged"] not in (0.0, 1.0):
        raise ValueError(f"setting {run.setting[:50]!r}: diverged must be 0 or 1")
    return run, {"commit": line["commit"], **measures}
