"""Lets the threads of a walker exchange numbers.

Where a walker has two by two threads, `jnp.flip` over one of their axes is an exchange: each
thread gets the number of the other (a warp shuffle). All threads of a warp must reach it, so a loop
runs as often as any of them needs, and no exchange may be in a branch.
"""

import math

import numpy as np

from hitl_jax.walker.gpu.lanes import Lanes
from hitl_jax.walker.gpu.ptx import Element, PtxWriter, Register
from hitl_jax.walker.gpu.registers import array_of, elements_of


class ExchangingLanes(Lanes):
    """Lanes whose threads exchange numbers; all of a walker's threads are in one block."""

    def __init__(self, writer: PtxWriter, lanes: tuple[int, ...]):
        """See `Lanes`."""
        super().__init__(writer, lanes)
        self._exchanges = lanes[:-1] == (2, 2)
        self._in_branch = False
        """Whether the other threads may be at another place of the program."""

    def exchanged(self, value: np.ndarray, axis: int) -> np.ndarray:
        """The numbers of the other thread along an axis of the lanes."""
        if not self._exchanges or self._lanes[axis] != 2 or self._in_branch:
            raise NotImplementedError(f"axis {axis} of {self._lanes} flipped, or in a branch")
        distance = math.prod(self._lanes[axis + 1 : -1])
        others = [self._of_other(element, distance) for element in elements_of(value)]
        return array_of(others, value.shape)

    def _of_other(self, element: Element, distance: int) -> Element:
        """The other thread's number; the two threads' own indices differ by `distance`, one bit.

        The hardware does not wait for threads that do not exist or have ended.
        """
        if not isinstance(element, Register):
            return element
        if element.kind == "pred":
            as_number = self._writer.convert(element, "s32")
            return self._writer.convert(self._of_other(as_number, distance), "pred")
        return self._writer.apply(
            "shfl.sync.bfly.b32", element.kind, element, str(distance), "31", "-1"
        )

    def goes_on(self, wanted: Element) -> Element:
        """Whether this thread runs a loop's body again, from whether it needs to."""
        if not self._exchanges or self._in_branch:
            return wanted
        held = self._writer.held(wanted)
        return self._writer.apply("vote.sync.any.pred", "pred", held, "-1")
