"""A function of a batch as one kernel of a GPU: a walker a thread or a few, numbers in registers.

XLA makes a kernel of each handful of operations. The solver's loops are hundreds of rounds of a
hundred small operations each: on a GPU they would spend their time on starting kernels and on
memory. Here the function's jaxpr is written as the instructions of one thread (`jaxpr_to_ptx`,
`ptx`), which XLA takes as they are. On other devices the function stays as it is.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import gpu
from hitl_jax.walker.gpu.four_threads.thread import NeighbourThread
from hitl_jax.walker.gpu.jaxpr_to_ptx import Thread, array_of, elements_of
from hitl_jax.walker.gpu.ptx import Writer

_NAME = "walker"
_PLACEHOLDER = 9973
"""Stands for the batch while a function is traced; no other axis is as long."""


def as_kernel(function: Callable[..., Any], parts: tuple[int, ...] = ()) -> Callable[..., Any]:
    """The function as one kernel, for the GPUs of `gpu.on_gpu`; else itself.

    Whether anybody needs another round is asked of each thread by itself: a loop must do nothing to
    those that need none.

    Args:
        function: of pytrees whose leaves' last axis is the batch, or 1, to such; what it does not
            get as an argument must be constant.
        parts: lengths of the axes before the batch's, in all leaves, whose places get a thread
            each. They do not feel each other, unless `NeighbourThread` says how.

    Returns:
        A function of the same arguments.
    """
    return functools.partial(call, function, parts) if gpu.on_gpu() else function


def call(function: Callable[..., Any], parts: tuple[int, ...], *args: Any) -> Any:
    """Calls a function as a kernel; see `as_kernel`. Traced anywhere, it runs on NVIDIA's GPUs."""
    leaves, structure = jax.tree.flatten(args)
    batch = max(leaf.shape[-1] for leaf in leaves)
    leaves = [jnp.broadcast_to(leaf, (*leaf.shape[:-1], batch)) for leaf in leaves]
    shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
    text, told = written(function, parts, jax.tree.unflatten(structure, shapes))
    told_leaves, told_structure = jax.tree.flatten(told)
    threads = batch * math.prod(parts)
    cores = getattr(gpu.default_device(), "core_count", 1)
    block = _thread_class().block_size(threads, math.prod(parts), cores)
    sizes = {"grid_x": math.ceil(threads / block), "grid_y": 1, "grid_z": 1}
    sizes |= {"block_x": block, "block_y": 1, "block_z": 1, "shared_mem_bytes": 0}
    results = jax.ffi.ffi_call("__gpu$xla.gpu.ptx", told_leaves)(
        *leaves,
        name=_NAME,
        kernel_type="ptx",
        kernel_data=text,
        **{name: np.int32(size) for name, size in sizes.items()},
        output_indices=tuple(np.int32(len(leaves) + index) for index in range(len(told_leaves))),
    )
    return jax.tree.unflatten(told_structure, results)


def _thread_class() -> type[Thread]:
    return NeighbourThread if gpu.uses_four_threads() else Thread


def written(function: Callable[..., Any], parts: tuple[int, ...], args: Any) -> tuple[str, Any]:
    """The kernel's text, and the shapes of what it tells.

    Args:
        function: see `as_kernel`.
        parts: likewise.
        args: a tuple of pytrees of shapes, which all end with one batch.
    """
    lanes = (*parts, _PLACEHOLDER)
    leaves, structure = jax.tree.flatten(args)
    batch = leaves[0].shape[-1]
    if wrong := [leaf.shape for leaf in leaves if leaf.shape[-len(lanes) :] != (*parts, batch)]:
        raise ValueError(f"an argument of shape {wrong[0]}: must end with {(*parts, batch)}")
    traced = [jax.ShapeDtypeStruct((*leaf.shape[:-1], _PLACEHOLDER), leaf.dtype) for leaf in leaves]
    closed, told = jax.make_jaxpr(function, return_shape=True)(
        *jax.tree.unflatten(structure, traced)
    )
    ends = [leaf.shape for leaf in jax.tree.leaves(told)]
    if wrong := [shape for shape in ends if shape[-len(lanes) :] != lanes]:
        raise ValueError(f"a result of shape {wrong[0]}: must end with the batch")
    told = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((*leaf.shape[:-1], batch), leaf.dtype), told
    )
    results = jax.tree.leaves(told)

    writer = Writer()
    threads = batch * math.prod(parts)
    thread = _thread_class()(writer, lanes)
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
    return writer.text(_NAME, len(addresses)), told
