"""Makes a function of a batch one kernel on a GPU: a thread or a few per walker.

XLA makes a kernel of every few operations. The solver's loops are hundreds of iterations of a
hundred small operations each: on a GPU such kernels would spend their time on launches and memory.
Here the function's jaxpr is written as the instructions of one thread (`jaxpr_to_ptx`, `ptx`), with
all numbers in registers; XLA calls the result as it is. On other devices nothing is changed.
"""

import functools
import math
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker.gpu.jaxpr_to_ptx import ThreadWriter
from hitl_jax.walker.gpu.ptx import PtxWriter
from hitl_jax.walker.gpu.registers import array_of, elements_of
from hitl_jax.xla import gpu

_WARP = 32
"""Threads that a GPU runs together."""
_BLOCKS_PER_CORE = 8
"""Two for each scheduler of a multiprocessor. Blocks are small while there are fewer: the threads
of a block wait for its slowest one, and run each other's branches."""
_PLACEHOLDER = 9973
"""Length of the batch while a function is traced; no other axis may have it."""


def as_kernel(function: Callable[..., Any], parts: tuple[int, ...] = ()) -> Callable[..., Any]:
    """The function as one kernel, where `gpu.on_gpu`; elsewhere the function itself.

    Each thread decides alone how often it runs a loop's body: the body must leave walkers unchanged
    that need no more iterations.

    Args:
        function: takes and returns pytrees whose leaves' last axis is the batch, or 1; all else
            that it uses must be constant.
        parts: lengths of the axes just before the batch's, in all leaves: each place of them gets a
            thread. Threads are independent, except where they exchange numbers, see `exchange`.

    Returns:
        A function of the same arguments.
    """
    return functools.partial(call, function, parts) if gpu.on_gpu() else function


def call(function: Callable[..., Any], parts: tuple[int, ...], *args: Any) -> Any:
    """Calls a function as a kernel, see `as_kernel`; traced anywhere, it runs on a GPU."""
    leaves, structure = jax.tree.flatten(args)
    batch = max(leaf.shape[-1] for leaf in leaves)
    leaves = [jnp.broadcast_to(leaf, (*leaf.shape[:-1], batch)) for leaf in leaves]
    shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
    text, shapes_out = kernel_text(function, parts, jax.tree.unflatten(structure, shapes))
    out_leaves, out_structure = jax.tree.flatten(shapes_out)
    threads = batch * math.prod(parts)
    cores = getattr(gpu.default_device(), "core_count", 1)
    block = block_size(threads, math.prod(parts), cores)
    sizes = {"grid_x": math.ceil(threads / block), "grid_y": 1, "grid_z": 1}
    sizes |= {"block_x": block, "block_y": 1, "block_z": 1, "shared_mem_bytes": 0}
    results = jax.ffi.ffi_call("__gpu$xla.gpu.ptx", out_leaves)(
        *leaves,
        name=_name(function),
        kernel_type="ptx",
        kernel_data=text,
        **{name: np.int32(size) for name, size in sizes.items()},
        output_indices=tuple(np.int32(len(leaves) + index) for index in range(len(out_leaves))),
    )
    return jax.tree.unflatten(out_structure, results)


def block_size(threads: int, parts: int, cores: int) -> int:
    """Threads in a block; a walker's threads, a power of 2, are in one block.

    Args:
        threads: number of threads of the kernel.
        parts: number of threads of a walker.
        cores: number of the GPU's multiprocessors.
    """
    block = parts
    while block < _WARP and threads > block * cores * _BLOCKS_PER_CORE:
        block *= 2
    return block


def _name(function: Callable[..., Any]) -> str:
    """A kernel's name, by which profiles tell it from others."""
    named = function.func if isinstance(function, functools.partial) else function
    # Of a lambda's name without what PTX does not allow.
    return "walker_" + re.sub(r"^_+|\W", "", named.__name__, flags=re.ASCII)


def kernel_text(function: Callable[..., Any], parts: tuple[int, ...], args: Any) -> tuple[str, Any]:
    """Writes a kernel.

    Args:
        function: see `as_kernel`.
        parts: see `as_kernel`.
        args: a tuple of pytrees of shapes, which all end with one batch.

    Returns:
        The kernel's PTX, and the shapes of its results.

    Raises:
        ValueError: if an argument or a result does not end with `parts` and the batch.
        NotImplementedError: if the function uses an operation that kernels do not have.
    """
    lanes = (*parts, _PLACEHOLDER)
    leaves, structure = jax.tree.flatten(args)
    batch = leaves[0].shape[-1]
    if wrong := [leaf.shape for leaf in leaves if leaf.shape[-len(lanes) :] != (*parts, batch)]:
        raise ValueError(f"an argument of shape {wrong[0]}: must end with {(*parts, batch)}")
    traced = [jax.ShapeDtypeStruct((*leaf.shape[:-1], _PLACEHOLDER), leaf.dtype) for leaf in leaves]
    closed, shapes_out = jax.make_jaxpr(function, return_shape=True)(
        *jax.tree.unflatten(structure, traced)
    )
    result_shapes = [leaf.shape for leaf in jax.tree.leaves(shapes_out)]
    if wrong := [shape for shape in result_shapes if shape[-len(lanes) :] != lanes]:
        raise ValueError(f"a result of shape {wrong[0]}: must end with the batch")
    shapes_out = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((*leaf.shape[:-1], batch), leaf.dtype), shapes_out
    )
    results = jax.tree.leaves(shapes_out)

    writer = PtxWriter()
    threads = batch * math.prod(parts)
    thread = ThreadWriter(writer, lanes)
    place = thread.begin(batch)
    addresses = [
        writer.address(index, place, leaf.dtype) for index, leaf in enumerate([*leaves, *results])
    ]
    given = []
    for address, leaf in zip(addresses, leaves, strict=False):
        outer = leaf.shape[: -len(lanes)]
        rows = range(math.prod(outer))
        given.append(
            array_of([writer.load(address, row * threads, leaf.dtype) for row in rows], outer)
        )
    for address, value in zip(
        addresses[len(leaves) :], thread.run_closed(closed, given), strict=True
    ):
        for row, element in enumerate(elements_of(value)):
            writer.store(address, row * threads, element)
    return writer.text(_name(function), len(addresses)), shapes_out
