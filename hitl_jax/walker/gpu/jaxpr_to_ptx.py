"""Writes a jaxpr as the PTX instructions of one thread.

The jaxpr is that of a function of a batch. Each array [..., B] is taken apart: a thread has one
number of it for each place of its leading axes, in a register. So slices, stacks and broadcasts
need no instructions, and constants are in the text. A loop runs as often as this thread needs, or
the threads with which it exchanges numbers.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker.gpu.array_rules import ArrayRules
from hitl_jax.walker.gpu.control_flow_rules import ControlFlowRules
from hitl_jax.walker.gpu.ptx import Element, kind_of
from hitl_jax.walker.gpu.registers import array_of, elements_of
from hitl_jax.walker.gpu.sincos import cosine, sine


class ThreadWriter(ArrayRules, ControlFlowRules):
    """Writes the instructions of one thread; rules for single numbers are here."""

    def run(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[Any]) -> list[np.ndarray]:
        """Writes a jaxpr's instructions.

        Args:
            jaxpr: of a function whose arrays end with the lanes, or have none.
            consts: values of its constants.
            args: values of its arguments.

        Returns:
            The values of its results.
        """
        values: dict[Any, np.ndarray] = {}

        def read(atom: Any) -> np.ndarray:
            if isinstance(atom, jex.Literal):
                return self.constant(np.asarray(atom.val, atom.aval.dtype))  # type: ignore[attr-defined]
            return values[atom]

        values.update(zip(jaxpr.constvars, consts, strict=True))
        values.update(zip(jaxpr.invars, args, strict=True))
        for eqn in jaxpr.eqns:
            given = [read(atom) for atom in eqn.invars]
            rule = getattr(self, "_" + eqn.primitive.name, self._each)
            results = rule(eqn, given)
            values.update(zip(eqn.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def run_closed(self, closed: Any, args: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Writes a closed jaxpr's instructions; the values of its results."""
        consts = [self.constant(np.asarray(const)) for const in closed.consts]
        return self.run(closed.jaxpr, consts, args)

    # Rules, named as the primitives; each takes an equation and its operands' values.

    def _each(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        """An operation on each number by itself, which the writer has by the primitive's name."""
        operate = functools.partial(self._writer.operate, eqn.primitive.name)
        return [self._mapped(operate, eqn, given)]

    def _select_n(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        choose = self._writer.choose
        return [self._mapped(lambda which, no, yes: choose(which, yes, no), eqn, given)]

    def _convert_element_type(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        kind = kind_of(eqn.params["new_dtype"])
        return [self._mapped(lambda element: self._writer.convert(element, kind), eqn, given)]

    def _round(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        if eqn.params["rounding_method"] != jax.lax.RoundingMethod.TO_NEAREST_EVEN:
            raise NotImplementedError("round halves away from zero in a kernel")
        return self._each(eqn, given)

    def traced(
        self, function: Callable[..., Any], eqn: Any, given: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Applies a JAX function of scalars to each number."""
        scalars = [jax.ShapeDtypeStruct((), atom.aval.dtype) for atom in eqn.invars]
        closed = jax.make_jaxpr(function)(*scalars)

        def one(*elements: Element) -> Element:
            (answer,) = self.run_closed(closed, [array_of([element], ()) for element in elements])
            return elements_of(answer)[0]

        return [self._mapped(one, eqn, given)]

    def _sin(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self.traced(sine, eqn, given)

    def _cos(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self.traced(cosine, eqn, given)

    def _sign(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        return self.traced(_sign, eqn, given)

    def _mapped(
        self, function: Callable[..., Any], eqn: Any, given: list[np.ndarray]
    ) -> np.ndarray:
        """Applies a function to each number; axes of length 1 are broadcast."""
        shape = eqn.outvars[0].aval.shape
        lanes, outer = self.has_lanes(shape), self.outer(shape)
        stretched = []
        for value, atom in zip(given, eqn.invars, strict=True):
            if lanes and not self.has_lanes(atom.aval.shape):
                value = value.reshape((1,) * (len(shape) - value.ndim) + value.shape)
                value = self.gathered(value)
            stretched.append(np.broadcast_to(value, outer))
        return array_of(
            [function(*row) for row in zip(*map(elements_of, stretched), strict=True)], outer
        )

    def _inline(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        """A nested call."""
        closed = eqn.params["jaxpr"] if "jaxpr" in eqn.params else eqn.params["call_jaxpr"]
        return self.run(closed.jaxpr, [self.constant(np.asarray(c)) for c in closed.consts], given)

    _jit = _pjit = _custom_jvp_call = _inline


def _sign(number: jax.Array) -> jax.Array:
    one, zero = jnp.ones_like(number), jnp.zeros_like(number)
    return jnp.where(number > zero, one, jnp.where(number < zero, -one, number))
