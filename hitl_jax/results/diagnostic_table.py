"""Diagnostics of a run as a table: a row for each sample that was taken of its learners.

Its first columns count; the others are what the run's learners measure (`team.diagnostics`), whose
names a learner of one's own may choose.
"""

import io
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from hitl_jax.results.episode_tables import Table, cells_from_csv, finite, table_to_csv

FILE = "diagnostics.csv"
"""Of a run's folder."""

COUNTERS = ("updates", "env_steps", "episodes")
"""Updates of the task learner, environment steps and training episodes before the sample."""

_NAME = r"[a-z][a-z0-9_]{0,59}"
_MOST_COLUMNS = 100
_MOST_MEASURED = 60
"""By a learner; the others are the counters, and the boundary learner's."""
_GREATEST = 1e30


def require_measured(names: Collection[Any]) -> None:
    """Checks what a learner calls its metrics, before any is measured.

    Raises:
        ValueError: one line, for a name that can be no column, or is a counter's; or for too many.
    """
    for name in names:
        if not (isinstance(name, str) and re.fullmatch(_NAME, name)) or name in COUNTERS:
            raise ValueError(
                f"metric {str(name)[:70]!r}: must begin with a to z, have a to z, 0 to 9 and _, at "
                f"most 60 of them, and be none of {', '.join(COUNTERS)}"
            )
    if len(names) > _MOST_MEASURED:
        raise ValueError(f"{len(names)} metrics: must be at most {_MOST_MEASURED}")


def diagnostics_to_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV; without rows the header of `COUNTERS`. What is not finite becomes an empty cell.

    Raises:
        ValueError: one line, if the rows have no such names, or not all the same.
    """
    first = rows[0] if rows else {}
    names = (*COUNTERS, *sorted(set(first) - set(COUNTERS)))
    _require_names(names)
    if any(set(row) != set(names) for row in rows):
        raise ValueError("diagnostics: the rows have different columns")
    table = {name: np.array([float(row[name]) for row in rows]) for name in names}
    counts = {name: table[name].astype(np.int64) for name in COUNTERS}
    measured = {
        name: np.where(np.abs(table[name]) <= _GREATEST, table[name], np.nan)
        for name in names[len(COUNTERS) :]
    }
    return table_to_csv(counts | measured)


def diagnostics_from_csv(text: str) -> Table:
    """The inverse of `diagnostics_to_csv`.

    Earlier commits wrote nothing at all where there were no rows: of that there are no columns.

    Returns:
        Columns by name: int64 [K] for `COUNTERS`, float64 [K] for the others, NaN where a number is
        not known or was not finite.

    Raises:
        ValueError: one line saying what is wrong.
    """
    if not text:
        return {}
    names = tuple(io.StringIO(text).readline().strip().split(","))
    _require_names(names)
    cells = cells_from_csv(text, names)
    numbers = {
        name: finite(name, [cell or "nan" for cell in values], or_nan=name not in COUNTERS)
        for name, values in cells.items()
    }
    for name in COUNTERS:
        counts = numbers[name]
        if (counts < 0).any() or (counts != np.floor(counts)).any() or (np.diff(counts) < 0).any():
            raise ValueError(f"column {name!r} does not count upwards")
        numbers[name] = counts.astype(np.int64)
    return numbers


def _require_names(names: Sequence[str]) -> None:
    if tuple(names[: len(COUNTERS)]) != COUNTERS or len(names) > _MOST_COLUMNS:
        raise ValueError(f"diagnostics: the header is not {','.join(COUNTERS)},…")
    wrong = [name for name in names if not re.fullmatch(_NAME, name)]
    if wrong or len(set(names)) < len(names):
        raise ValueError(f"diagnostics: {str(wrong or names)[:50]}: is no name of a column")
