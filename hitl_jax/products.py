"""The product of a dense layer, with its gradient in the forms for which XLA has fast CPU kernels.

Of the three products of a layer only the gradient of its kernel, xᵀ g, sums over an axis that is
not the last of its left operand. XLA's CPU kernels for that are slower, and several times slower
where g is narrow.
"""

import chex
import jax
import jax.numpy as jnp

from hitl_jax.border import border

_NARROW = 32
"""Fewer columns than this are better the rows of the result."""

_LONG = 128
"""From so many rows on, a transposed copy costs less than it saves: 8 % at 128 and 256 columns,
nothing at 64 rows."""

_FEW = 4
"""Columns, and `_SMALL` rows, from which on a form of our own is taken: of smaller products XLA
makes loops, and aborts where their layout is another than usual."""

_SMALL = 32
"""Rows and inputs; see `_FEW`."""


@jax.custom_vjp
def product(x: chex.Array, kernel: chex.Array) -> chex.Array:
    """Inputs times weights, x · kernel, for one layer or a stack of them.

    Args:
        x: inputs, [..., B, I].
        kernel: weights, [..., I, O].

    Returns:
        Outputs, [..., B, O].
    """
    return jnp.einsum("...bi,...io->...bo", x, kernel)


def _forward(x: chex.Array, kernel: chex.Array) -> tuple[chex.Array, tuple[chex.Array, chex.Array]]:
    return product(x, kernel), (x, kernel)


def _backward(
    residuals: tuple[chex.Array, chex.Array], gradient: chex.Array
) -> tuple[chex.Array, chex.Array]:
    x, kernel = residuals
    return (
        jnp.einsum("...bo,...io->...bi", gradient, kernel),
        jax.lax.platform_dependent(x, gradient, cpu=_of_kernel_on_cpu, default=_of_kernel),
    )


product.defvjp(_forward, _backward)


def _of_kernel(x: chex.Array, gradient: chex.Array) -> chex.Array:
    """The gradient of the kernel, [..., I, O]."""
    return jnp.einsum("...bi,...bo->...io", x, gradient)


def _of_kernel_on_cpu(x: chex.Array, gradient: chex.Array) -> chex.Array:
    rows, inputs = x.shape[-2:]
    outputs = gradient.shape[-1]
    # Without barriers XLA would make of either form the product that it stands for.
    if min(rows, inputs) >= _SMALL and _FEW <= outputs < _NARROW:
        turned = jnp.einsum("...bo,...bi->...oi", gradient, x)
        return jnp.swapaxes(jax.lax.optimization_barrier(turned), -1, -2)
    if rows >= _LONG and min(inputs, outputs) >= _SMALL:
        turned = jax.lax.optimization_barrier(jnp.swapaxes(border(x), -1, -2))
        return jnp.einsum("...ib,...bo->...io", turned, gradient)
    return _of_kernel(x, gradient)
