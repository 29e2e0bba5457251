"""Diagnostics of a run as a table."""

import io

import numpy as np
import pandas
import pytest

from hitl_jax.results.diagnostic_table import COUNTERS, diagnostics_from_csv, diagnostics_to_csv

_ROWS = [
    {"q": 1.5, "updates": 1000, "env_steps": 3000, "episodes": 4, "boundary_critic_loss": np.nan},
    {"q": np.inf, "updates": 2000, "env_steps": 5000, "episodes": 4, "boundary_critic_loss": -2.0},
]


def test_rows_come_back():
    text = diagnostics_to_csv(_ROWS)
    assert text.splitlines()[0] == "updates,env_steps,episodes,boundary_critic_loss,q"
    table = diagnostics_from_csv(text)
    assert table["updates"].tolist() == [1000, 2000]
    assert table["updates"].dtype == np.int64
    np.testing.assert_array_equal(table["q"], [1.5, np.nan])  # An infinite number is not kept.
    np.testing.assert_array_equal(table["boundary_critic_loss"], [np.nan, -2.0])


def test_no_samples_are_a_header():
    text = diagnostics_to_csv([])
    assert text == "updates,env_steps,episodes\n"
    table = diagnostics_from_csv(text)
    assert {name: len(values) for name, values in table.items()} == dict.fromkeys(COUNTERS, 0)
    assert pandas.read_csv(io.StringIO(text)).empty
    assert diagnostics_from_csv("") == {}  # As earlier commits wrote it.


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("updates,q\n1,2\n", "the header is not updates,env_steps,episodes"),
        ("updates,env_steps,episodes,Q!\n1,2,3,4\n", "is no name of a column"),
        ("updates,env_steps,episodes,q,q\n1,2,3,4,5\n", "is no name of a column"),
        ("updates,env_steps,episodes,q\n1,2,3\n", "line 2 has 3 of 4 cells"),
        ("updates,env_steps,episodes,q\n2,2,3,0\n1,2,3,0\n", "does not count upwards"),
        ("updates,env_steps,episodes,q\n1.5,2,3,0\n", "does not count upwards"),
        ("updates,env_steps,episodes,q\n1,2,3,zero\n", "must be a number"),
        ("updates,env_steps,episodes,q\n1,2,3,1e40\n", "not finite"),
        ("updates,env_steps,episodes,q\n,2,3,0\n", "not finite"),
    ],
)
def test_what_is_none_is_refused(text, told):
    with pytest.raises(ValueError, match=told):
        diagnostics_from_csv(text)


def test_rows_of_other_columns_are_refused():
    with pytest.raises(ValueError, match="the rows have different columns"):
        diagnostics_to_csv([_ROWS[0], {name: 0 for name in _ROWS[0] if name != "q"}])
