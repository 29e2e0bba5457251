"""The product of a dense layer, with a gradient in forms for which XLA has fast CPU kernels.

The learner's networks use it. Of a layer's three products only the gradient of its kernel, xᵀ g,
sums over an axis that is not the last of its left operand. XLA computes such a product with a
slower kernel, and where g is narrow with a loop that is several times slower.

Operands can be rounded to bfloat16, which some processors multiply faster; sums, and everything
else, stay float32. (JAX's own setting, `jax_default_matmul_precision`, changes nothing on a CPU:
with "bfloat16" and "BF16_BF16_F32" JAX 0.10.2 compiles the same product of float32.)
"""

import functools

import chex
import jax
import jax.numpy as jnp

from hitl_jax.xla.fusion_barrier import fusion_barrier

MATMUL_PRECISIONS = ("float32", "bfloat16")

_NARROW = 32
"""With fewer outputs than this the transpose of gᵀ x is faster; with more, xᵀ g with x transposed
first."""

_MANY_ROWS = 128
"""With at least so many rows transposing x costs less than it saves: it saves 8 % with 128 and 256
outputs, nothing with 64 rows."""

_LEAST = 32
_LEAST_OUTPUTS = 4
"""Least rows and inputs, and least outputs, for which one of our forms is used. XLA compiles very
small products to loops, and JAX 0.10.2 aborts where a stack of their results is transposed
(`dot_op_emitter.cc`, "Check failed: ... IsMonotonicWithDim0Major")."""


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def product(x: chex.Array, kernel: chex.Array, matmul_precision: str = "float32") -> chex.Array:
    """Inputs times weights, x · kernel, for one layer or a stack of them.

    Args:
        x: inputs, [..., B, I], float32.
        kernel: weights, [..., I, O], float32.
        matmul_precision: static, one of `MATMUL_PRECISIONS`: the type to which the operands of this
            product, and of its gradient's products, are rounded.

    Returns:
        Outputs, [..., B, O].
    """
    return _forward(x, kernel, matmul_precision)[0]


def _forward(
    x: chex.Array, kernel: chex.Array, matmul_precision: str
) -> tuple[chex.Array, tuple[chex.Array, chex.Array]]:
    chex.assert_equal_shape_prefix([x, kernel], x.ndim - 2)
    chex.assert_type([x, kernel], jnp.float32)
    x, kernel = x.astype(matmul_precision), kernel.astype(matmul_precision)
    return _einsum("...bi,...io->...bo", x, kernel), (x, kernel)


def _backward(
    matmul_precision: str, residuals: tuple[chex.Array, chex.Array], gradient: chex.Array
) -> tuple[chex.Array, chex.Array]:
    x, kernel = residuals
    gradient = gradient.astype(matmul_precision)
    return (
        _einsum("...bo,...io->...bi", gradient, kernel),
        jax.lax.platform_dependent(x, gradient, cpu=_of_kernel_on_cpu, default=_of_kernel),
    )


product.defvjp(_forward, _backward)


def _einsum(subscripts: str, left: chex.Array, right: chex.Array) -> chex.Array:
    """A product with float32 sums, whatever its operands."""
    return jnp.einsum(subscripts, left, right, preferred_element_type=jnp.float32)


def _of_kernel(x: chex.Array, gradient: chex.Array) -> chex.Array:
    """The gradient of the kernel, xᵀ g, [..., I, O]."""
    return _einsum("...bi,...bo->...io", x, gradient)


def _of_kernel_on_cpu(x: chex.Array, gradient: chex.Array) -> chex.Array:
    """The same in the form that is fastest for its shape.

    The optimization barriers keep XLA's simplifier from turning either form into xᵀ g again. The
    fusion barrier keeps it from computing x, a layer's nonlinearity, again in the transposed copy.
    """
    rows, inputs = x.shape[-2:]
    outputs = gradient.shape[-1]
    if min(rows, inputs) >= _LEAST and _LEAST_OUTPUTS <= outputs < _NARROW:
        transposed = _einsum("...bo,...bi->...oi", gradient, x)
        return jnp.swapaxes(jax.lax.optimization_barrier(transposed), -1, -2)
    if rows >= _MANY_ROWS and min(inputs, outputs) >= _LEAST:
        transposed = jax.lax.optimization_barrier(jnp.swapaxes(fusion_barrier(x), -1, -2))
        return _einsum("...ib,...bo->...io", transposed, gradient)
    return _of_kernel(x, gradient)
