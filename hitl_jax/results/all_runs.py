"""A table of all finished runs of a results folder, as pandas reads it in one line."""

import os

import numpy as np

from hitl_jax.choices.checks import one_of
from hitl_jax.results.episode_tables import Table
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import sort_keys

_TABLES = {"episodes": "episodes", "test": "tests", "progress": "progress"}


def load_table(path: str | os.PathLike[str], name: str = "episodes") -> Table:
    """`pandas.DataFrame(load_table("results/full", "test"))`: the runs one after the other.

    Args:
        path: the folder of the results.
        name: `episodes` (of training), `test`, or `progress` (tests along training).

    Returns:
        Columns by name, of equal lengths: `method`, `seed`, and those of the runs' tables; none if
        no run has finished.

    Raises:
        InvalidValue: one line, for another name.
        ResultsError: one line, if the folder is none, or is damaged.
    """
    one_of("table", name, tuple(_TABLES))
    folder = ResultsFolder(path)
    folder.load_config()
    parts: list[Table] = []
    for key in sort_keys(folder.finished()):
        table: Table = getattr(folder.load_run(key), _TABLES[name])
        rows = len(next(iter(table.values())))
        named = {"method": np.full(rows, key.method), "seed": np.full(rows, key.seed)}
        parts.append(named | table)
    if not parts:
        return {}
    return {column: np.concatenate([part[column] for part in parts]) for column in parts[0]}
