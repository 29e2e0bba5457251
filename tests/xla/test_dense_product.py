"""The dense product and its gradients equal a plain matrix product's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hitl_jax.xla.dense_product import MATMUL_PRECISIONS, product

# XLA changes products only when it optimises.
pytestmark = pytest.mark.usefixtures("compiled_fully")

_PLAIN = [(3, 5, 2), (3, 2, 4), (31, 40, 10), (64, 31, 31), (64, 40, 3)]
_PLAIN += [(127, 40, 64), (130, 40, 1)]
_NARROW = [(32, 32, 4), (32, 40, 10), (128, 40, 31)]
_TRANSPOSED = [(128, 32, 32), (128, 40, 64), (130, 40, 33)]
_STACKS = pytest.mark.parametrize("stack", [(), pytest.param((2,), marks=pytest.mark.slow)])


def _operands(rows, inputs, outputs, stack):
    """Inputs, weights, and weights of the outputs in a sum."""
    rng = np.random.default_rng(0)
    shapes = (rows, inputs), (inputs, outputs), (rows, outputs)
    return [jnp.asarray(rng.normal(size=(*stack, *shape)), jnp.float32) for shape in shapes]


def _value_and_gradients(multiply):
    def total(x, kernel, weight):
        return jnp.sum(weight * multiply(x, kernel))

    return jax.value_and_grad(total, argnums=(0, 1))


def _assert_close(ours, theirs):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-3), ours, theirs)


@pytest.mark.parametrize(("rows", "inputs", "outputs"), _PLAIN + _NARROW + _TRANSPOSED)
@_STACKS
def test_product_and_its_gradient_are_those_of_a_matrix_product(rows, inputs, outputs, stack):
    given = _operands(rows, inputs, outputs, stack)
    ours = jax.jit(_value_and_gradients(product))(*given)
    _assert_close(ours, _value_and_gradients(jnp.matmul)(*given))


@pytest.mark.parametrize(("rows", "inputs", "outputs"), _PLAIN[:1] + _NARROW + _TRANSPOSED)
@_STACKS
@pytest.mark.parametrize("precision", MATMUL_PRECISIONS)
def test_gradients_under_vmap(rows, inputs, outputs, stack, precision):
    given = [
        value.astype(precision).astype("float32")
        for value in _operands(rows, inputs, outputs, (3, *stack))
    ]
    ours = jax.jit(jax.vmap(_value_and_gradients(lambda *both: product(*both, precision))))(*given)
    _assert_close(ours, jax.vmap(_value_and_gradients(jnp.matmul))(*given))


@pytest.mark.parametrize(("rows", "inputs", "outputs"), _PLAIN[:1] + _NARROW + _TRANSPOSED)
@_STACKS
def test_bfloat16_rounds_operands_and_nothing_else(rows, inputs, outputs, stack):
    given = _operands(rows, inputs, outputs, stack)
    rounded = [value.astype("bfloat16").astype("float32") for value in given]
    # The gradient of the outputs is the weights of the sum.
    ours = jax.jit(_value_and_gradients(lambda *both: product(*both, "bfloat16")))
    theirs = _value_and_gradients(jnp.matmul)
    _assert_close(ours(*given[:2], rounded[2]), theirs(*rounded))
    _assert_close(ours(*given)[1], theirs(*rounded)[1])
    assert {one.dtype for one in jax.tree.leaves(ours(*given))} == {np.dtype("float32")}


def test_gradients_are_those_of_small_differences():
    x, kernel, _ = _operands(32, 32, 4, ())
    check_grads(product, (x, kernel), order=1, modes=["rev"], atol=1e-2, rtol=1e-2)


def test_operands_of_different_stacks_are_refused():
    with pytest.raises(AssertionError, match="shape"):
        product(jnp.ones((2, 3, 4)), jnp.ones((4, 5)))
