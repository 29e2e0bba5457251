"""Networks whose weights all rows share tell the same of a row, whatever rows are beside it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.human.experience import expectation
from hitl_jax.human.trained_walker import trained_walker
from hitl_jax.xla.row_by_row import row_by_row

pytestmark = pytest.mark.usefixtures("compiled_fully")

_ROWS = np.random.default_rng(0).normal(size=(130, 24)).astype(np.float32)


def _hands(row):
    return trained_walker().act((), row, None)[1]


def _of_ones_own(row):
    weights = np.random.default_rng(1).normal(size=(24, 130)).astype(np.float32)
    return jnp.tanh(row @ weights)


@pytest.mark.parametrize("function", [_hands, expectation, row_by_row(_of_ones_own)])
def test_neighbours_do_not_change_a_bit(function):
    many = np.asarray(jax.jit(jax.vmap(function))(_ROWS))
    assert np.abs(many).max() > 0.01
    for size in (2, 3, 5, 17, 33, 64, 96, 129):
        few = jax.jit(jax.vmap(function))(_ROWS[-size:])
        np.testing.assert_array_equal(few, many[-size:])
    nested = jax.jit(jax.vmap(jax.vmap(function)))(_ROWS.reshape(13, 10, 24))
    np.testing.assert_array_equal(nested.reshape(many.shape), many)
    np.testing.assert_allclose(jax.jit(function)(_ROWS[0]), many[0], rtol=1e-4, atol=1e-6)
