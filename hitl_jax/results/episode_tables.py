"""Tables of episodes: their columns, their checks, and CSV both ways.

A table in memory is a dict from column name to a one-dimensional array, all of one length: one row
an episode. Text columns hold str, counts int64, and the rest float64, NaN where there is no value.
"""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hitl_jax.results.episode_measures import MEASURES, NAN

Table = dict[str, np.ndarray]
"""Column name to values [T]."""

METHODS = ("srl", "hitl-fix", "hitl-ac")
"""The methods that are compared, in the order of tables and legends: reinforcement learning alone
(SRL), with a human and a fixed boundary, with a human and a learned boundary."""

ENDS = ("fall", "goal", "terminated", "time-limit", "human-reset")
"""How an episode ended; "terminated": by the environment, and what that means is not known."""
MODES = ("autonomous", "assisted")

_NAMES = tuple(measure.name for measure in MEASURES)
_BEFORE_STEPS = _NAMES.index("length") + 1

EPISODE_COLUMNS = ("episode", *_NAMES[:_BEFORE_STEPS], "env_steps", *_NAMES[_BEFORE_STEPS:])
"""Columns of a run's training episodes: its number, counted from 1; the `MEASURES`; and, behind the
episode's length, the environment steps of the run so far, this episode included."""

TEST_COLUMNS = ("mode", "episode", *(measure.name for measure in MEASURES if measure.in_tests))
"""Columns of a run's test episodes: one of `MODES`; its number; and those of the `MEASURES` that
tests have."""

PROGRESS_COLUMNS = ("trained", *TEST_COLUMNS)
"""Columns of a run's test episodes before its end; `trained` counts training episodes until
then."""

_TEXT = {"mode": MODES, "end": ENDS}
_FLOATS = tuple(measure.name for measure in MEASURES if measure.kind == "number")
_NUMBER = r"(?:-?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?|nan|)"
"""As Python writes it; NaN is a cell without anything too."""
_MOST_COUNT = 2**53
_GREATEST = 1e30
"""Of what is measured: greater numbers are none, and their sums overflow."""
_LONGEST_CELL = 1000
_MAY_BE_NAN = tuple(measure.name for measure in MEASURES if measure.may_be_nan)
_ABSENT: dict[str, Any] = {
    measure.name: measure.absent for measure in MEASURES if measure.absent is not None
}
"""Values of columns that came later, in tables that were written without them."""


def to_table(columns: Mapping[str, object], names: tuple[str, ...]) -> Table:
    """Checks columns and brings them to the types and the order of a table.

    Args:
        columns: sequences or arrays [T], exactly those of `names`.
        names: `EPISODE_COLUMNS`, `TEST_COLUMNS` or `PROGRESS_COLUMNS`.

    Returns:
        The table, with copies of the values.

    Raises:
        ValueError: one line naming the column that is missing, unknown, of another length, or holds
            a value that it cannot.
    """
    missing, unknown = set(names) - set(columns), set(columns) - set(names)
    if missing or unknown:
        raise ValueError(f"columns missing: {sorted(missing)}, unknown: {sorted(unknown)}")
    table = {name: _column(name, columns[name]) for name in names}
    lengths = {name: len(values) for name, values in table.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns differ in length: {lengths}")
    return table


def to_columns(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[str, list[Any]]:
    """Rows as columns of these names; what else a row holds is left out."""
    return {name: [row[name] for row in rows] for name in names}


def table_to_csv(table: Table) -> str:
    """CSV with a header; NaN is an empty cell, and a float reads back as the same float."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    # NaN alone differs from itself.
    columns = [["" if v != v else v for v in values.tolist()] for values in table.values()]
    writer.writerows(zip(*columns, strict=True))
    return text.getvalue()


def table_from_csv(text: str, names: tuple[str, ...]) -> Table:
    """The inverse of `table_to_csv`; columns that came later may be missing.

    Raises:
        ValueError: one line saying what is wrong, with the line of the file where there is one.
    """
    header = next(csv.reader(io.StringIO(text)), [])
    absent = _ABSENT | ({"mode": MODES[0]} if names == PROGRESS_COLUMNS else {})
    later = [name for name in names if name in absent and name not in header]
    columns: dict[str, Any] = dict(
        cells_from_csv(text, tuple(name for name in names if name not in later))
    )
    rows = len(columns[names[0]])
    return to_table(columns | {name: np.full(rows, absent[name]) for name in later}, names)


def rows_to_csv(rows: Iterable[Mapping[str, Any]], names: Sequence[str]) -> str:
    """CSV with a header; None is an empty cell.

    Args:
        rows: of these columns and no others; a column that a row lacks is an empty cell.
        names: of the columns, in their order.

    Raises:
        ValueError: for a row with another column.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def cells_from_csv(text: str, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """The cells of a CSV as text, by column.

    Raises:
        ValueError: one line, if the header is another, or a line is cut short.
    """
    if not text.replace("\n", "").isprintable():  # NumPy's texts end at a NUL.
        raise ValueError("holds control characters")
    rows = list(csv.reader(io.StringIO(text)))
    if not rows or tuple(rows[0]) != names:
        raise ValueError(f"the header is not {','.join(names[:3])},…")
    for number, row in enumerate(rows[1:], start=2):
        if max(map(len, row), default=0) > _LONGEST_CELL:
            raise ValueError(f"line {number} has a cell of more than {_LONGEST_CELL} characters")
        if len(row) != len(names):
            raise ValueError(f"line {number} has {len(row)} of {len(names)} cells")
    if not text.endswith("\n"):
        raise ValueError(f"line {len(rows)} is cut short")
    cells = zip(*rows[1:], strict=True) if len(rows) > 1 else ((),) * len(names)
    return dict(zip(names, cells, strict=True))


def numbers_from_csv(text: str, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """A CSV whose cells are all finite numbers, float64 [T] by column.

    Raises:
        ValueError: one line saying what is wrong.
    """
    return {name: finite(name, cells) for name, cells in cells_from_csv(text, names).items()}


def finite(name: str, cells: Sequence[str], or_nan: bool = False) -> np.ndarray:
    """Cells of a column as finite numbers, float64 [T].

    Args:
        name: of the column.
        cells: as text.
        or_nan: whether NaN is a number too.

    Raises:
        ValueError: one line naming the column.
    """
    _require_digits(name, cells)
    numbers = np.array([float(cell) for cell in cells], np.float64)
    if not ((np.abs(numbers) <= _GREATEST) | (np.isnan(numbers) & or_nan)).all():
        raise ValueError(f"column {name!r} holds a value that is not finite")
    return numbers


def _require_digits(name: str, cells: Sequence[str]) -> None:
    """Refuses what Python reads as a number and no program writes, such as `1_0` or ` 1`."""
    if not re.fullmatch(rf"({_NUMBER}\n)*", "".join(f"{cell}\n" for cell in cells)):
        wrong = next((cell for cell in cells if not re.fullmatch(_NUMBER, cell)), "")
        raise ValueError(f"column {name!r} holds {wrong[:50]!r}: must be a number")


def select(table: Table, column: str, value: str | int) -> Table:
    """The rows in which `column` is `value`."""
    rows = table[column] == value
    return {name: values[rows] for name, values in table.items()}


def _column(name: str, values: object) -> np.ndarray:
    array = np.asarray(values)
    if array.ndim != 1:
        raise ValueError(f"column {name!r} has shape {array.shape}: must be one-dimensional")
    if name in _TEXT:
        wrong = set(array.tolist()) - set(_TEXT[name])
        if wrong:
            raise ValueError(f"column {name!r} holds {min(wrong)!r}: not in {_TEXT[name]}")
        return array.astype(str)
    if array.dtype.kind == "U":
        cells = array.tolist()
        _require_digits(name, cells)
        array = np.array([float(cell or NAN) for cell in cells], np.float64)
    try:
        numbers = array.astype(float)
    except ValueError as error:
        raise ValueError(f"column {name!r}: {error}") from error
    if name not in _MAY_BE_NAN and not np.isfinite(numbers).all():
        raise ValueError(f"column {name!r} holds a value that is missing or not finite")
    if name in _FLOATS:
        if (np.abs(numbers) > _GREATEST).any():
            raise ValueError(f"column {name!r} holds a value beyond {_GREATEST:g}")
        return numbers
    if (numbers != np.floor(numbers)).any():
        raise ValueError(f"column {name!r} holds a value that is not a whole number")
    most = 1 if name == "fall" else _MOST_COUNT
    if ((numbers < 0) | (numbers > most)).any():
        raise ValueError(f"column {name!r} holds a value that is not from 0 to {most}")
    return numbers.astype(np.int64)
