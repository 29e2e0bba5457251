"""Writes threads that exchange numbers with the other threads of their walker.

Where a walker has two by two threads, `jnp.flip` over one of their axes is an exchange: each
thread gets the number of the other (a warp shuffle). All threads of a warp must reach it, so a loop
runs as often as any of them needs, and no exchange may be in a branch.
"""

import math
from typing import Any

import numpy as np

from hitl_jax.walker.gpu.four_threads.sincos import cosine, sine
from hitl_jax.walker.gpu.jaxpr_to_ptx import ThreadWriter
from hitl_jax.walker.gpu.lanes import WARP
from hitl_jax.walker.gpu.ptx import Element, PtxWriter, Register
from hitl_jax.walker.gpu.registers import array_of, elements_of

_BLOCKS_PER_CORE = 8
"""Two for each scheduler of a multiprocessor. Blocks are small while there are fewer: the threads
of a block wait for its slowest one, and run each other's branches."""


class ExchangingThreadWriter(ThreadWriter):
    """Writes one of a walker's threads; all of a walker's threads are in one block."""

    def __init__(self, writer: PtxWriter, lanes: tuple[int, ...]):
        """See `ThreadWriter`."""
        super().__init__(writer, lanes)
        self._exchanges = lanes[:-1] == (2, 2)
        self._in_branch = False
        """Whether the other threads may be at another place of the program."""

    @staticmethod
    def block_size(threads: int, parts: int, cores: int) -> int:
        """Threads in a block; a walker's threads, a power of 2, are in one block."""
        block = parts
        while block < WARP and threads > block * cores * _BLOCKS_PER_CORE:
            block *= 2
        return block

    def begin(self, batch: int) -> Register:
        """Begins the kernel: the index of the thread's number in an array [parts, batch]."""
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

    def _goes_on(self, wanted: Element) -> Element:
        if not self._exchanges or self._in_branch:
            return wanted
        held = self._writer.held(wanted)
        return self._writer.apply("vote.sync.any.pred", "pred", held, "-1")

    def _cond(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        before, self._in_branch = self._in_branch, True
        results = super()._cond(eqn, given)
        self._in_branch = before
        return results
