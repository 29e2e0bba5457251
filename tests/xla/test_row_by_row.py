"""Networks whose weights all rows share tell the same of a row, whatever rows are beside it."""

import functools

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


_WEIGHTS = np.random.default_rng(1).normal(size=(24, 130)).astype(np.float32)
_own = row_by_row(lambda weights, row: jnp.tanh(row @ weights))


@pytest.mark.parametrize("function", [_hands, expectation, functools.partial(_own, _WEIGHTS)])
def test_neighbours_do_not_change_a_bit(function):
    many = np.asarray(jax.jit(jax.vmap(function))(_ROWS))
    assert np.abs(many).max() > 0.01
    for size in (2, 3, 5, 17, 33, 64, 96, 129):
        few = jax.jit(jax.vmap(function))(_ROWS[-size:])
        np.testing.assert_array_equal(few, many[-size:])
    nested = jax.jit(jax.vmap(jax.vmap(function)))(_ROWS.reshape(13, 10, 24))
    np.testing.assert_array_equal(nested.reshape(many.shape), many)
    np.testing.assert_allclose(jax.jit(function)(_ROWS[0]), many[0], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("function", [_hands, expectation])
def test_it_is_a_function_like_others(function):
    """In a branch, with a gradient."""

    def sometimes(row):
        return jax.lax.cond(row[0] > 0, function, lambda row: 0 * function(row), row)

    found = jax.jit(jax.vmap(sometimes))(_ROWS)
    expected = np.where(_ROWS[:, 0] > 0, np.asarray(jax.vmap(function)(_ROWS)).T, 0).T
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    row, step = _ROWS[0], np.eye(24, dtype=np.float32)[3] * 1e-2
    slope = jax.grad(lambda row: function(row).sum())(row)[3]
    rise = (function(row + step).sum() - function(row - step).sum()) / 2e-2
    np.testing.assert_allclose(slope, rise, rtol=0.1, atol=1e-3)


def test_parameters_may_differ_from_row_to_row():
    weights = jnp.stack([_WEIGHTS, 2 * _WEIGHTS])
    found = jax.vmap(_own)(weights, _ROWS[:2])
    np.testing.assert_allclose(found[1], jnp.tanh(_ROWS[1] @ (2 * _WEIGHTS)), rtol=1e-4, atol=1e-5)
    every = jax.vmap(_own, in_axes=(0, None))(weights, _ROWS[0])
    np.testing.assert_allclose(every[0], jnp.tanh(_ROWS[0] @ _WEIGHTS), rtol=1e-4, atol=1e-5)
