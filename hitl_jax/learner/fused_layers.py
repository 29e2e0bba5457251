"""The dense layers of a network as one kernel on a GPU, and their gradients as another.

XLA makes a kernel of every product, every sum over rows and most of what is between, and what one
gives to the next goes through the GPU's memory: for small networks that is most of the time. Here
one kernel reads the weights of a network, and keeps a block of rows in registers from the first
layer to the last. The gradients' kernel computes the layers again instead of reading them.

The kernels are Pallas's, written for one network; `vmap` makes a batch of them. Products round
their operands to TensorFloat-32, as XLA's do on a GPU, and sum in float32.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton

from hitl_jax.xla import gpu

_ROWS = 64
"""Rows that a block of threads works on."""
_LEAST = 16
"""Least length of an axis of a product; axes are filled up with zeros to a power of two."""
_MOST_WEIGHTS = 128 * 128
"""Of a layer: they must fit into a multiprocessor's shared memory."""
_WARPS = 8
LAYER_NORM_EPSILON = 1e-6


class Layer(NamedTuple):
    """A dense layer: weights [I, F] and bias [F]."""

    kernel: chex.Array
    bias: chex.Array


def fits(rows: int, sizes: Sequence[int]) -> bool:
    """Whether the kernels can compute a network for so many rows.

    Args:
        rows: B.
        sizes: of the input, of the hidden layers and of the output.
    """
    full = [_full(size) for size in sizes]
    return (
        (rows % _ROWS == 0 or rows in (_LEAST, 2 * _LEAST))
        and full[1:-1] == list(sizes[1:-1])
        and all(a * b <= _MOST_WEIGHTS for a, b in itertools.pairwise(full))
    )


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def dense_layers(x: chex.Array, layers: Sequence[Layer], layer_norm: bool) -> chex.Array:
    """What dense layers with ReLUs between them answer.

    Args:
        x: inputs, float32 [B, I]; `fits`.
        layers: from the first to the last, float32.
        layer_norm: static; whether hidden layers are normalised, without gain and shift.

    Returns:
        The last layer's outputs, [B, F].
    """
    size = layers[-1].bias.shape[0]
    [blocks] = _call(_answer, x, layers, layer_norm, (), [(_rows(x), _full(size))])
    return blocks.reshape(len(x), -1)[:, :size]


def _forward(
    x: chex.Array, layers: Sequence[Layer], layer_norm: bool
) -> tuple[chex.Array, tuple[chex.Array, Sequence[Layer]]]:
    return dense_layers(x, layers, layer_norm), (x, layers)


def _backward(
    layer_norm: bool, residuals: tuple[chex.Array, Sequence[Layer]], gradient: chex.Array
) -> tuple[chex.Array, Sequence[Layer]]:
    # Two calls: XLA drops the one whose results nobody asks for.
    x, layers = residuals
    beside = (_filled(gradient, gradient.shape[-1:]),)
    [of_x] = _call(
        _gradient_of_inputs, x, layers, layer_norm, beside, [(_rows(x), _full(x.shape[1]))]
    )
    leaves, structure = jax.tree.flatten(layers)
    shapes = [tuple(map(_full, leaf.shape)) for leaf in leaves]
    of_layers = _call(_gradients_of_layers, x, layers, layer_norm, beside, shapes)
    own = [
        blocks.sum(axis=0)[tuple(map(slice, leaf.shape))]
        for blocks, leaf in zip(of_layers, leaves, strict=True)
    ]
    return of_x.reshape(len(x), -1)[:, : x.shape[1]], jax.tree.unflatten(structure, own)


dense_layers.defvjp(_forward, _backward)


def _rows(x: chex.Array) -> int:
    """Rows of a block."""
    return min(len(x), _ROWS)


def _full(size: int) -> int:
    """The length to which an axis is filled up."""
    return max(_LEAST, 1 << (size - 1).bit_length())


def _filled(leaf: chex.Array, sizes: Sequence[int]) -> chex.Array:
    """An array whose last axes are filled up with zeros."""
    pads = [(0, 0)] * (leaf.ndim - len(sizes)) + [(0, _full(size) - size) for size in sizes]
    return jnp.pad(leaf, pads)


def _call(
    body: Callable[..., list[chex.Array]],
    x: chex.Array,
    layers: Sequence[Layer],
    layer_norm: bool,
    beside: tuple[chex.Array, ...],
    shapes: Sequence[tuple[int, ...]],
) -> list[chex.Array]:
    """Results of a kernel for each block of rows, [blocks, *shape] for each of the shapes.

    Args:
        body: what a block of threads computes, from the layers, whether they are normalised, and
            the block's rows of `x` and of what is `beside`.
        x: inputs, [B, I].
        layers: of the network.
        layer_norm: see `dense_layers`.
        beside: more rows, [B, ...], filled up.
        shapes: of a block's results.
    """
    x = _filled(x, x.shape[1:])
    leaves = [_filled(leaf, leaf.shape) for leaf in jax.tree.leaves(layers)]
    structure, blocks = jax.tree.structure(layers), len(x) // _rows(x)
    by_rows = (x, *beside)

    def kernel(*refs: Any) -> None:
        given = [ref[...] for ref in refs[: len(by_rows) + len(leaves)]]
        own = jax.tree.unflatten(structure, given[len(by_rows) :])
        results = body(own, layer_norm, *given[: len(by_rows)])
        for ref, result in zip(refs[len(given) :], results, strict=True):
            ref[...] = result

    def of_block(shape: tuple[int, ...]) -> pl.BlockSpec:
        return pl.BlockSpec((None, *shape), lambda block: (block, *(0,) * len(shape)))

    def whole(leaf: chex.Array) -> pl.BlockSpec:
        return pl.BlockSpec(leaf.shape, lambda block: (0,) * leaf.ndim)

    results: list[chex.Array] = pl.pallas_call(
        kernel,
        grid=(blocks,),
        in_specs=[
            *(pl.BlockSpec((_rows(x), a.shape[1]), lambda block: (block, 0)) for a in by_rows),
            *map(whole, leaves),
        ],
        out_specs=[of_block(shape) for shape in shapes],
        out_shape=[jax.ShapeDtypeStruct((blocks, *shape), jnp.float32) for shape in shapes],
        compiler_params=triton.CompilerParams(num_warps=_WARPS, num_stages=1),
        interpret=not gpu.on_gpu(),  # For tests: the same, operation by operation.
    )(*by_rows, *leaves)
    return results


class _Hidden(NamedTuple):
    """A hidden layer of a block of rows: its inputs, and what goes into its ReLU.

    Attributes:
        inputs: [B, I].
        before: [B, F], normalised where layers are.
        scale: by which rows were multiplied, [B, 1]; None where they are not normalised.
    """

    inputs: chex.Array
    before: chex.Array
    scale: chex.Array | None


def _hidden(layers: Sequence[Layer], layer_norm: bool, x: chex.Array) -> list[_Hidden]:
    """The hidden layers."""
    computed = []
    for layer in layers[:-1]:
        before, scale = _times(x, layer.kernel) + layer.bias[None], None
        if layer_norm:
            mean = jnp.mean(before, axis=1, keepdims=True)
            before = before - mean
            variance = jnp.mean(before * before, axis=1, keepdims=True)
            scale = jax.lax.rsqrt(variance + LAYER_NORM_EPSILON)
            before = before * scale
        computed.append(_Hidden(x, before, scale))
        x = jnp.maximum(before, 0.0)
    return computed


def _times(left: chex.Array, right: chex.Array, over: tuple[int, int] = (1, 0)) -> chex.Array:
    """A product of matrices that sums over these axes of them."""
    return jax.lax.dot_general(
        left, right, (((over[0],), (over[1],)), ((), ())), preferred_element_type=jnp.float32
    )


def _last_inputs(hidden: list[_Hidden], x: chex.Array) -> chex.Array:
    return jnp.maximum(hidden[-1].before, 0.0) if hidden else x


def _answer(layers: Sequence[Layer], layer_norm: bool, x: chex.Array) -> list[chex.Array]:
    hidden = _hidden(layers, layer_norm, x)
    return [_times(_last_inputs(hidden, x), layers[-1].kernel) + layers[-1].bias[None]]


def _through(hidden: _Hidden, gradient: chex.Array) -> chex.Array:
    """The gradient of a hidden layer's product, from that of its outputs."""
    gradient = jnp.where(hidden.before > 0.0, gradient, 0.0)
    if hidden.scale is None:
        return gradient
    mean = jnp.mean(gradient, axis=1, keepdims=True)
    along = jnp.mean(gradient * hidden.before, axis=1, keepdims=True)
    return (gradient - mean - along * hidden.before) * hidden.scale


def _gradient_of_inputs(
    layers: Sequence[Layer], layer_norm: bool, x: chex.Array, gradient: chex.Array
) -> list[chex.Array]:
    hidden = _hidden(layers, layer_norm, x)
    for layer, one in zip(reversed(layers), [*reversed(hidden), None], strict=True):
        gradient = _times(gradient, layer.kernel, over=(1, 1))
        if one is not None:
            gradient = _through(one, gradient)
    return [gradient]


def _gradients_of_layers(
    layers: Sequence[Layer], layer_norm: bool, x: chex.Array, gradient: chex.Array
) -> list[chex.Array]:
    hidden = _hidden(layers, layer_norm, x)
    inputs = _last_inputs(hidden, x)
    found: list[chex.Array] = []
    for layer, one in zip(reversed(layers), [*reversed(hidden), None], strict=True):
        found = [_times(inputs, gradient, over=(0, 0)), jnp.sum(gradient, axis=0), *found]
        if one is not None:
            gradient = _through(one, _times(gradient, layer.kernel, over=(1, 1)))
            inputs = one.inputs
    return found
