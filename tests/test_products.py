import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hitl_jax.products import product


@pytest.mark.parametrize(
    ("rows", "inputs", "outputs"),
    [(3, 5, 2), (3, 2, 4), (32, 40, 10), (8, 40, 64), (128, 16, 64), (128, 40, 64), (130, 40, 1)],
)
@pytest.mark.parametrize("stack", [(), (2,)])
def test_product_and_its_gradient_are_those_of_a_matrix_product(rows, inputs, outputs, stack):
    rng = np.random.default_rng(0)
    x = jnp.asarray(rng.normal(size=(*stack, rows, inputs)), jnp.float32)
    kernel = jnp.asarray(rng.normal(size=(*stack, inputs, outputs)), jnp.float32)
    weight = jnp.asarray(rng.normal(size=(*stack, rows, outputs)), jnp.float32)

    def total(multiply):
        return lambda x, kernel: jnp.sum(weight * multiply(x, kernel))

    ours = jax.jit(jax.value_and_grad(total(product), argnums=(0, 1)))(x, kernel)
    theirs = jax.value_and_grad(total(jnp.matmul), argnums=(0, 1))(x, kernel)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-3), ours, theirs)


def test_gradients_under_vmap():
    rng = np.random.default_rng(1)
    x = jnp.asarray(rng.normal(size=(3, 4, 5)), jnp.float32)
    kernel = jnp.asarray(rng.normal(size=(3, 5, 2)), jnp.float32)
    each = jax.vmap(product)
    check_grads(each, (x, kernel), order=1, modes=["rev"], atol=1e-2, rtol=1e-2)
