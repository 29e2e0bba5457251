"""A jaxpr, written as the instructions of one thread.

The jaxpr is that of a function of a batch. Each array [..., B] is taken apart: a thread has one
number of it for each place of its leading axes, in a register. So nothing is left of slices, stacks
and broadcasts, loops go round as often as this thread needs, and constants stand in the text.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker.gpu.ptx import Element, Register, Writer, kind_of
from hitl_jax.walker.gpu.sincos import cosine, sine

_WARP = 32


class Thread:
    """Writes what one thread does.

    A value is a NumPy array of registers and constants. That of an array whose shape ends with the
    lanes' has its leading axes, that of another all its axes.
    """

    def __init__(self, writer: Writer, lanes: tuple[int, ...]):
        """Writes nothing yet.

        Args:
            writer: of the instructions.
            lanes: the last axes of arrays of which each thread has one number: those of a walker's
                parts, if there are any, and the batch.
        """
        self._writer = writer
        self._lanes = lanes
        self._rank = len(lanes)
        self._part: Element | None = None
        """The thread's place on the axes of the parts."""

    @staticmethod
    def block_size(threads: int, parts: int, cores: int) -> int:
        """Threads of a block: few, so that a thousand walkers keep a large GPU's processors busy.

        Args:
            threads: of the kernel.
            parts: threads of a walker.
            cores: the GPU's multiprocessors.
        """
        del threads, parts, cores
        return _WARP

    def begin(self, batch: int) -> Register:
        """The place of the thread's number in an array [parts, batch].

        Threads stand as the numbers do: those of the first part, then those of the second.
        """
        parts = math.prod(self._lanes[:-1])
        place = self._writer.begin(batch * parts)
        if self._rank > 1:
            self._part = self._writer.operate("div", place, np.int32(batch))
        return place

    def has_lanes(self, shape: Sequence[int]) -> bool:
        """Whether arrays of this shape are taken apart into arrays of lanes."""
        return tuple(shape[-self._rank :]) == self._lanes

    def outer(self, shape: Sequence[int]) -> tuple[int, ...]:
        """The axes that the value of an array has."""
        return tuple(shape[: -self._rank]) if self.has_lanes(shape) else tuple(shape)

    def constant(self, const: np.ndarray) -> np.ndarray:
        """The value of an array without lanes."""
        return array_of(list(const.ravel()), const.shape)

    def run(self, jaxpr: Any, consts: Sequence[Any], args: Sequence[Any]) -> list[np.ndarray]:
        """The values of a jaxpr's results."""
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

    # Rules, named as the primitives; each from an equation and the values of its operands.

    def _each(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        """Any operation that works on each number by itself."""
        operate = functools.partial(self._writer.operate, eqn.primitive.name)
        return [self._mapped(operate, eqn, given)]

    def _select_n(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        choose = self._writer.choose
        return [self._mapped(lambda which, no, yes: choose(which, yes, no), eqn, given)]

    def _convert_element_type(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        kind = kind_of(eqn.params["new_dtype"])
        return [self._mapped(lambda element: self._writer.convert(element, kind), eqn, given)]

    def traced(
        self, function: Callable[..., Any], eqn: Any, given: list[np.ndarray]
    ) -> list[np.ndarray]:
        """A function of scalars, of all elements."""
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
        """A function of elements, of all elements; axes of length 1 are stretched."""
        shape = eqn.outvars[0].aval.shape
        lanes, outer = self.has_lanes(shape), self.outer(shape)
        stretched = []
        for value, atom in zip(given, eqn.invars, strict=True):
            if lanes and not self.has_lanes(atom.aval.shape):
                value = value.reshape((1,) * (len(shape) - value.ndim) + value.shape)
                value = self._gathered(value)
            stretched.append(np.broadcast_to(value, outer))
        return array_of(
            [function(*row) for row in zip(*map(elements_of, stretched), strict=True)], outer
        )

    def _inline(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        closed = eqn.params["jaxpr"] if "jaxpr" in eqn.params else eqn.params["call_jaxpr"]
        return self.run(closed.jaxpr, [self.constant(np.asarray(c)) for c in closed.consts], given)

    _jit = _pjit = _custom_jvp_call = _inline

    def _broadcast_in_dim(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        value, *_ = given
        before, shape = eqn.invars[0].aval.shape, eqn.params["shape"]
        aligned = [1] * len(shape)
        for length, axis in zip(before, eqn.params["broadcast_dimensions"], strict=True):
            aligned[axis] = length
        if self.has_lanes(before):
            value = value.reshape(aligned[: -self._rank])
        elif self.has_lanes(shape):
            value = self._gathered(value.reshape(aligned))
        else:
            value = value.reshape(aligned)
        return [np.broadcast_to(value, self.outer(shape))]

    def _gathered(self, value: np.ndarray) -> np.ndarray:
        """Numbers that differ along the axes of the parts, if at all, as a thread has them."""
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
                value = self._exchanged(value, axis - value.ndim)
        return [value]

    def _exchanged(self, value: np.ndarray, axis: int) -> np.ndarray:
        """The numbers of the other thread along an axis of the lanes."""
        del value
        raise NotImplementedError(f"axis {axis} of {self._lanes} flipped in a kernel")

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
        """A reduction; over the lanes it is a thread's own number.

        That is good for the flags that say whether a loop goes on, and for nothing else.
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

    def _round(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        if eqn.params["rounding_method"] != jax.lax.RoundingMethod.TO_NEAREST_EVEN:
            raise NotImplementedError("round halves away from zero in a kernel")
        return self._each(eqn, given)

    def _cumsum(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        axis = eqn.params["axis"]
        if eqn.params["reverse"] or axis >= given[0].ndim:
            raise NotImplementedError("cumsum from behind, or over threads, in a kernel")
        rows = np.split(given[0], given[0].shape[axis], axis)
        return [np.concatenate(list(itertools.accumulate(rows, self._sum)), axis)]

    def _sum(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        pairs = zip(elements_of(first), elements_of(second), strict=True)
        return array_of([self._writer.operate("add", *pair) for pair in pairs], first.shape)

    def _while(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        of_test, of_body = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        test_consts, body_consts = given[:of_test], given[of_test : of_test + of_body]
        carry = self._copied(given[of_test + of_body :])
        with self._writer.loop() as end:
            (test,) = self.run_closed(eqn.params["cond_jaxpr"], [*test_consts, *carry])
            self._writer.branch(end, unless=self._goes_on(elements_of(test)[0]))
            after = self.run_closed(eqn.params["body_jaxpr"], [*body_consts, *carry])
            self._writer.move_all(_flat(carry), _flat(after))
        return carry

    def _goes_on(self, wanted: Element) -> Element:
        """Whether a loop goes round again where this thread wants it, or does not."""
        return wanted

    def _scan(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        closed = eqn.params["jaxpr"]
        if eqn.params["reverse"]:
            raise NotImplementedError("a scan from behind in a kernel")
        inside = [atom.aval.shape for atom in closed.jaxpr.invars]
        if inside != [atom.aval.shape for atom in eqn.invars]:
            return self._unrolled(eqn, given, inside)
        results = [atom.aval.shape for atom in closed.jaxpr.outvars]
        if results != [atom.aval.shape for atom in eqn.outvars]:
            raise NotImplementedError("a scan over nothing that tells of each step, in a kernel")
        num_consts = len(given) - len(eqn.outvars)
        count = self._copied([array_of([np.int32(0)], ())])[0]
        carry = self._copied(given[num_consts:])
        with self._writer.loop() as end:
            (made,) = elements_of(count)
            goes = self._writer.operate("lt", made, np.int32(eqn.params["length"]))
            self._writer.branch(end, unless=goes)
            after = self.run_closed(closed, [*given[:num_consts], *carry])
            following = self._writer.operate("add", made, np.int32(1))
            self._writer.move_all([made, *_flat(carry)], [following, *_flat(after)])
        return carry

    def _unrolled(
        self, eqn: Any, given: list[np.ndarray], inside: list[tuple[int, ...]]
    ) -> list[np.ndarray]:
        """A scan over arrays, one step after the other."""
        closed = eqn.params["jaxpr"]
        scanned = [atom.aval.shape != shape for atom, shape in zip(eqn.invars, inside, strict=True)]
        results = [atom.aval.shape for atom in closed.jaxpr.outvars]
        num_carry = sum(
            atom.aval.shape == shape for atom, shape in zip(eqn.outvars, results, strict=True)
        )
        first = scanned.index(True)
        given, told = list(given), []
        for place in range(eqn.params["length"]):
            rows = [
                array_of(elements_of(value[place : place + 1]), value.shape[1:]) if over else value
                for value, over in zip(given, scanned, strict=True)
            ]
            after = self.run_closed(closed, rows)
            given[first - num_carry : first] = after[:num_carry]
            told.append(after[num_carry:])
        stacked = [np.stack(column) for column in zip(*told, strict=True)]
        return [*given[first - num_carry : first], *stacked]

    def _cond(self, eqn: Any, given: list[np.ndarray]) -> list[np.ndarray]:
        which, *operands = given
        no, yes = eqn.params["branches"]
        other, end = self._writer.label(), self._writer.label()
        condition = self._writer.convert(elements_of(which)[0], "pred")
        self._writer.branch(other, unless=condition)
        results = self._copied(self.run_closed(yes, operands))
        self._writer.branch(end)
        self._writer.write(f"{other}:")
        self._writer.move_all(_flat(results), _flat(self.run_closed(no, operands)))
        self._writer.write(f"{end}:")
        return results

    def _copied(self, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The same values in registers of their own."""
        return [
            array_of([self._writer.copied(element) for element in elements_of(value)], value.shape)
            for value in values
        ]

    def run_closed(self, closed: Any, args: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The values of a closed jaxpr's results."""
        consts = [self.constant(np.asarray(const)) for const in closed.consts]
        return self.run(closed.jaxpr, consts, args)


def _sign(number: jax.Array) -> jax.Array:
    one, zero = jnp.ones_like(number), jnp.zeros_like(number)
    return jnp.where(number > zero, one, jnp.where(number < zero, -one, number))


def array_of(elements: Sequence[Any], shape: Sequence[int]) -> np.ndarray:
    """Objects as an array; NumPy itself would look into them."""
    flat = np.empty(len(elements), object)
    for place, element in enumerate(elements):
        flat[place] = element
    return flat.reshape(shape)


def elements_of(value: np.ndarray) -> list[Any]:
    """An array's objects, in order."""
    flat = value.reshape(-1)
    return [flat[place] for place in range(len(flat))]


def _flat(values: Sequence[np.ndarray]) -> list[Any]:
    return [element for value in values for element in elements_of(value)]
