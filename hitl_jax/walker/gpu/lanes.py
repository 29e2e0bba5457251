"""How the arrays of a jaxpr are shared out over the threads of a kernel.

The last axes of a batched array are its lanes: each thread has the numbers at one place of them.
"""

import abc
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hitl_jax.walker.gpu.ptx import Element, PtxWriter, Register
from hitl_jax.walker.gpu.registers import array_of, elements_of


class Lanes(abc.ABC):
    """The lanes of a kernel, and the values that one of its threads has of an array.

    A value is a NumPy array of registers and constants. An array whose shape ends with the lanes
    has a value of its leading axes; another array has a value of all its axes.
    """

    def __init__(self, writer: PtxWriter, lanes: tuple[int, ...]):
        """Writes nothing yet.

        Args:
            writer: of the instructions.
            lanes: lengths of the axes of which each thread has one place: those of a walker's
                parts, if there are any, and the batch.
        """
        self._writer = writer
        self._lanes = lanes
        self._rank = len(lanes)
        self._part: Element | None = None
        """The thread's place on the axes of the parts."""

    def begin(self, batch: int) -> Register:
        """Begins the kernel: the index of the thread's number in an array [parts, batch].

        A walker's threads follow each other.
        """
        writer, parts = self._writer, math.prod(self._lanes[:-1])
        thread = writer.begin(batch * parts)
        self._part = writer.apply("rem.s32", "s32", thread, str(parts))
        walker = writer.apply("div.s32", "s32", thread, str(parts))
        return writer.apply("mad.lo.s32", "s32", self._part, str(batch), walker)

    def has_lanes(self, shape: Sequence[int]) -> bool:
        """Whether arrays of this shape end with the lanes, so that a thread has a part of them."""
        return tuple(shape[-self._rank :]) == self._lanes

    def outer(self, shape: Sequence[int]) -> tuple[int, ...]:
        """The shape of the value of an array of this shape."""
        return tuple(shape[: -self._rank]) if self.has_lanes(shape) else tuple(shape)

    def constant(self, const: np.ndarray) -> np.ndarray:
        """The value of a constant array without lanes."""
        return array_of(list(const.ravel()), const.shape)

    def gathered(self, value: np.ndarray) -> np.ndarray:
        """The thread's own numbers of an array that differs along the parts' axes at most."""
        inner, outer = value.shape[-self._rank :], value.shape[: -self._rank]
        every = (*self._lanes[:-1], 1)
        if any(has not in (1, most) for has, most in zip(inner, every, strict=True)):
            raise NotImplementedError(f"an array of {inner} in a kernel over {self._lanes}")
        if math.prod(inner) > 1:
            inner, value = every, np.broadcast_to(value, (*outer, *every))
        chosen = []
        for of_parts in value.reshape(-1, math.prod(inner)):
            element, *others = elements_of(of_parts)
            for index, other in enumerate(others, start=1):
                assert self._part is not None
                here = self._writer.operate("eq", self._part, np.int32(index))
                element = self._writer.choose(here, other, element)
            chosen.append(element)
        return array_of(chosen, outer)

    def copied(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The same values in new registers."""
        return [
            array_of([self._writer.copied(element) for element in elements_of(value)], value.shape)
            for value in values
        ]

    @abc.abstractmethod
    def run_closed(self, closed: Any, args: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Writes a closed jaxpr's instructions; the values of its results."""
