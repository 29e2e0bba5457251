"""Rules for a jaxpr's operations on whole arrays: shapes, slices, reductions.

Most of them write no instructions: they choose among a thread's registers.
"""

import functools
import itertools
import math
from typing import Any

import numpy as np

from hitl_jax.walker.gpu.exchange import ExchangingLanes
from hitl_jax.walker.gpu.registers import array_of, elements_of


class ArrayRules(ExchangingLanes):
    """The rules; each is named as its primitive, and takes an equation and its operands' values."""

    def _broadcast_in_dim(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        value, *_ = given
        before, shape = eqn.invars[0].aval.shape, eqn.params["shape"]
        aligned = [1] * len(shape)
        for length, axis in zip(before, eqn.params["broadcast_dimensions"], strict=True):
            aligned[axis] = length
        if self.has_lanes(before):
            value = value.reshape(aligned[: -self._rank])
        elif self.has_lanes(shape):
            value = self.gathered(value.reshape(aligned))
        else:
            value = value.reshape(aligned)
        return [np.broadcast_to(value, self.outer(shape))]

    def _reshaped(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        (out,) = eqn.outvars
        before, after = eqn.invars[0].aval.shape, out.aval.shape
        if self.has_lanes(before) != self.has_lanes(after):
            raise NotImplementedError(f"{eqn.primitive} of {before} to {after} in a kernel")
        return [given[0].reshape(self.outer(after))]

    _reshape = _squeeze = _expand_dims = _reshaped

    def _slice(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        starts, stops = eqn.params["start_indices"], eqn.params["limit_indices"]
        shape = eqn.invars[0].aval.shape
        if self.has_lanes(shape) and not self.has_lanes(eqn.outvars[0].aval.shape):
            raise NotImplementedError("a slice of threads")
        strides = eqn.params["strides"] or (1,) * len(starts)
        cuts = itertools.islice(zip(starts, stops, strides, strict=True), given[0].ndim)
        return [given[0][tuple(slice(*cut) for cut in cuts)]]

    def _rev(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        (value,) = given
        axes = eqn.params["dimensions"]
        if outer := tuple(axis for axis in axes if axis < value.ndim):
            value = np.flip(value, outer)
        for axis in axes:
            if axis >= value.ndim:
                value = self.exchanged(value, axis - value.ndim)
        return [value]

    def _concatenate(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return [np.concatenate(given, eqn.params["dimension"])]

    def _split(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        places = np.cumsum(eqn.params["sizes"])[:-1]
        return np.split(given[0], places, eqn.params["axis"])

    def _stack(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return [np.stack(given, eqn.params["axis"])]

    def _unstack(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        axis = eqn.params["axis"]
        rows = np.moveaxis(given[0], axis, 0)
        return [
            array_of(elements_of(rows[place : place + 1]), rows.shape[1:])
            for place in range(len(rows))
        ]

    def _iota(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        shape, axis = eqn.params["shape"], eqn.params["dimension"]
        places = np.arange(shape[axis], dtype=eqn.params["dtype"])
        places = places.reshape([-1 if at == axis else 1 for at in range(len(shape))])
        return [self.constant(np.broadcast_to(places, self.outer(shape)))]

    def _reduced(self, name: str, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        """A reduction; over the lanes its result is the thread's own number.

        That is right for flags that say whether a loop goes on, and other uses are refused.
        """
        (value,) = given
        shape, axes = eqn.invars[0].aval.shape, set(eqn.params["axes"])
        inner = set(range(value.ndim, len(shape)))
        if inner & axes and (name not in ("and", "or") or not inner <= axes):
            raise NotImplementedError(f"{eqn.primitive} over threads")
        outer = sorted(axes - inner)
        rest = [axis for axis in range(value.ndim) if axis not in axes]
        left = tuple(value.shape[axis] for axis in rest)
        rows = value.transpose(*outer, *rest).reshape(-1, math.prod(left))
        two = functools.partial(self._writer.operate, name)
        columns = [elements_of(rows[:, place]) for place in range(rows.shape[1])]
        return [array_of([functools.reduce(two, column) for column in columns], left)]

    def _reduce_min(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self._reduced("min", eqn, given)

    def _reduce_max(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self._reduced("max", eqn, given)

    def _reduce_sum(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self._reduced("add", eqn, given)

    def _reduce_or(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self._reduced("or", eqn, given)

    def _reduce_and(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self._reduced("and", eqn, given)

    def _cumsum(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        axis = eqn.params["axis"]
        if eqn.params["reverse"] or axis >= given[0].ndim:
            raise NotImplementedError("cumsum from behind, or over threads, in a kernel")
        rows = np.split(given[0], given[0].shape[axis], axis)
        return [np.concatenate(list(itertools.accumulate(rows, self._sum)), axis)]

    def _sum(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        pairs = zip(elements_of(first), elements_of(second), strict=True)
        return array_of([self._writer.operate("add", *pair) for pair in pairs], first.shape)
