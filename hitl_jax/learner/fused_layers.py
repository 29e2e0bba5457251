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
_WIDTH = 64
"""Columns of a part of an array: more do not fit into a thread's registers."""
_WARPS = 4
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
    body: Callable[..., None],
    x: chex.Array,
    layers: Sequence[Layer],
    layer_norm: bool,
    beside: tuple[chex.Array, ...],
    shapes: Sequence[tuple[int, ...]],
) -> list[chex.Array]:
    """Results of a kernel for each block of rows, [blocks, *shape] for each of the shapes.

    Args:
        body: what a block of threads does with the layers' references, whether they are
            normalised, the block's rows of `x` and of what is `beside`, and the references of its
            results.
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
        rows, weights = refs[: len(by_rows)], refs[len(by_rows) : len(by_rows) + len(leaves)]
        own = jax.tree.unflatten(structure, weights)
        body(own, layer_norm, *map(_parts, rows), *refs[len(by_rows) + len(leaves) :])

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


Parts = list[chex.Array]
"""An array [B, F] in parts of some columns, which fit into registers."""


def _columns(size: int) -> list[Any]:
    """Where the parts of an axis are."""
    width = min(size, _WIDTH)
    return [pl.ds(begin, width) for begin in range(0, size, width)]


def _parts(ref: Any) -> Parts:
    return [ref[:, columns] for columns in _columns(ref.shape[1])]


class _Hidden(NamedTuple):
    """A hidden layer of a block of rows: its inputs, and what goes into its ReLU.

    Attributes:
        inputs: [B, I].
        before: [B, F], normalised where layers are.
        scale: by which rows were multiplied, [B, 1]; None where they are not normalised.
    """

    inputs: Parts
    before: Parts
    scale: chex.Array | None


def _times(left: chex.Array, right: chex.Array, over: tuple[int, int] = (1, 0)) -> chex.Array:
    """A product of matrices that sums over these axes of them."""
    return jax.lax.dot_general(
        left, right, (((over[0],), (over[1],)), ((), ())), preferred_element_type=jnp.float32
    )


def _product(x: Parts, kernel: Any, transposed: bool = False) -> Parts:
    """A layer's product, x · kernel, or x · kernelᵀ."""
    inner, outer = map(_columns, kernel.shape[::-1] if transposed else kernel.shape)

    def of(own: Any) -> chex.Array:
        if transposed:
            return sum(
                _times(part, kernel[own, seen], (1, 1)) for part, seen in zip(x, inner, strict=True)
            )
        return sum(_times(part, kernel[seen, own]) for part, seen in zip(x, inner, strict=True))

    return [of(own) for own in outer]


def _plus_bias(x: Parts, bias: Any) -> Parts:
    return [part + bias[own][None] for part, own in zip(x, _columns(bias.shape[0]), strict=True)]


def _mean(x: Parts) -> chex.Array:
    """Of each row, [B, 1]."""
    total: chex.Array = sum(jnp.sum(part, axis=1, keepdims=True) for part in x)
    return total / sum(part.shape[1] for part in x)


def _relu(x: Parts) -> Parts:
    return [jnp.maximum(part, 0.0) for part in x]


def _hidden(layers: Sequence[Layer], layer_norm: bool, x: Parts) -> list[_Hidden]:
    """The hidden layers."""
    computed = []
    for layer in layers[:-1]:
        before, scale = _plus_bias(_product(x, layer.kernel), layer.bias), None
        if layer_norm:
            mean = _mean(before)
            before = [part - mean for part in before]
            variance = _mean([part * part for part in before])
            scale = jax.lax.rsqrt(variance + LAYER_NORM_EPSILON)
            before = [part * scale for part in before]
        computed.append(_Hidden(x, before, scale))
        x = _relu(before)
    return computed


def _last_inputs(hidden: list[_Hidden], x: Parts) -> Parts:
    return _relu(hidden[-1].before) if hidden else x


def _write(ref: Any, x: Parts) -> None:
    for part, columns in zip(x, _columns(ref.shape[1]), strict=True):
        ref[:, columns] = part


def _answer(layers: Sequence[Layer], layer_norm: bool, x: Parts, answer: Any) -> None:
    inputs = _last_inputs(_hidden(layers, layer_norm, x), x)
    _write(answer, _plus_bias(_product(inputs, layers[-1].kernel), layers[-1].bias))


def _through(hidden: _Hidden, gradient: Parts) -> Parts:
    """The gradient of a hidden layer's product, from that of its outputs."""
    pairs = list(zip(gradient, hidden.before, strict=True))
    gradient = [jnp.where(before > 0.0, part, 0.0) for part, before in pairs]
    if hidden.scale is None:
        return gradient
    pairs = list(zip(gradient, hidden.before, strict=True))
    mean, along = _mean(gradient), _mean([part * before for part, before in pairs])
    return [(part - mean - along * before) * hidden.scale for part, before in pairs]


def _gradient_of_inputs(
    layers: Sequence[Layer], layer_norm: bool, x: Parts, gradient: Parts, of_x: Any
) -> None:
    hidden = _hidden(layers, layer_norm, x)
    for layer, one in zip(reversed(layers), [*reversed(hidden), None], strict=True):
        gradient = _product(gradient, layer.kernel, transposed=True)
        if one is not None:
            gradient = _through(one, gradient)
    _write(of_x, gradient)


def _gradients_of_layers(
    layers: Sequence[Layer], layer_norm: bool, x: Parts, gradient: Parts, *of_layers: Any
) -> None:
    hidden = _hidden(layers, layer_norm, x)
    inputs, of_last_first = _last_inputs(hidden, x), list(of_layers)
    for layer, one in zip(reversed(layers), [*reversed(hidden), None], strict=True):
        of_bias, of_kernel = of_last_first.pop(), of_last_first.pop()
        rows, columns = map(_columns, layer.kernel.shape)
        for part, own in zip(gradient, columns, strict=True):
            of_bias[own] = jnp.sum(part, axis=0)
            for given, seen in zip(inputs, rows, strict=True):
                of_kernel[seen, own] = _times(given, part, (0, 0))
        if one is not None:
            gradient = _through(one, _product(gradient, layer.kernel, transposed=True))
            inputs = one.inputs
