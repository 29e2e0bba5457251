"""Threads of a walker that are neighbours and tell each other, and blocks of few of them.

Where a walker has two by two threads, `jnp.flip` over one of their axes is an exchange: each thread
gets the number of the other. All threads must come to it, so loops go round as often as any thread
nearby needs, and no exchange may be in a branch.
"""

import math
from typing import Any

import numpy as np

from hitl_jax.walker.gpu.four_threads.sincos import cosine, sine
from hitl_jax.walker.gpu.jaxpr_to_ptx import Thread, array_of, elements_of
from hitl_jax.walker.gpu.ptx import Element, Register, Writer

_WARP = 32
_BLOCKS_OF_A_CORE = 8
"""Two for each of its schedulers. With fewer walkers than that takes, blocks are smaller: the
threads of one wait for its slowest, and take each other's branches."""


class NeighbourThread(Thread):
    """Writes what one of a walker's threads does; all of them are in one block."""

    def __init__(self, writer: Writer, lanes: tuple[int, ...]):
        """As for `Thread`."""
        super().__init__(writer, lanes)
        self._exchanges = lanes[:-1] == (2, 2)
        self._alone = False
        """Whether a thread may be where its neighbours are not."""

    @staticmethod
    def block_size(threads: int, parts: int, cores: int) -> int:
        """Threads of a block; a walker's, a power of 2, stay together."""
        block = parts
        while block < _WARP and threads > block * cores * _BLOCKS_OF_A_CORE:
            block *= 2
        return block

    def begin(self, batch: int) -> Register:
        """The place of the thread's number in an array [parts, batch]."""
        writer, parts = self._writer, math.prod(self._lanes[:-1])
        thread = writer.begin(batch * parts)
        self._part = writer.apply("rem.s32", "s32", thread, str(parts))
        walker = writer.apply("div.s32", "s32", thread, str(parts))
        return writer.apply("mad.lo.s32", "s32", self._part, str(batch), walker)

    def _sin(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self.traced(sine, eqn, given)

    def _cos(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self.traced(cosine, eqn, given)

    def _exchanged(self, value: np.ndarray, axis: int) -> np.ndarray:
        if not self._exchanges or self._lanes[axis] != 2 or self._alone:
            raise NotImplementedError(f"axis {axis} of {self._lanes} flipped, or in a branch")
        distance = math.prod(self._lanes[axis + 1 : -1])
        others = [self._of_other(element, distance) for element in elements_of(value)]
        return array_of(others, value.shape)

    def _of_other(self, element: Element, distance: int) -> Element:
        """The number of the thread whose own differs by one bit, worth a distance.

        Threads that a block does not have, or that have ended, are not waited for.
        """
        if not isinstance(element, Register):
            return element
        if element.kind == "pred":
            as_number = self._writer.convert(element, "s32")
            return self._writer.convert(self._of_other(as_number, distance), "pred")
        return self._writer.apply(
            "shfl.sync.bfly.b32", element.kind, element, str(distance), "31", "-1"
        )

    def _goes_on(self, wanted: Element) -> Element:
        if not self._exchanges or self._alone:
            return wanted
        held = self._writer.held(wanted)
        return self._writer.apply("vote.sync.any.pred", "pred", held, "-1")

    def _cond(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        before, self._alone = self._alone, True
        results = super()._cond(eqn, given)
        self._alone = before
        return results
