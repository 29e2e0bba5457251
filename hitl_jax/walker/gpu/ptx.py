"""Writes the PTX of a kernel, instruction by instruction, for one thread.

PTX is NVIDIA's documented assembly language, with unlimited registers:
https://docs.nvidia.com/cuda/parallel-thread-execution. The driver compiles it to machine code.
"""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

_HEAD = ".version 7.0\n.target sm_80\n.address_size 64\n"
_LETTERS = {"f32": "f", "s32": "r", "pred": "p", "u64": "d"}
_KINDS = {np.dtype(np.float32): "f32", np.dtype(np.int32): "s32", np.dtype(bool): "pred"}
_NUMBERS: dict[str, type[np.number]] = {"f32": np.float32, "s32": np.int32}
_SIZES = {"f32": 4, "s32": 4, "pred": 1}

_FLOAT = {
    "add": "add.f32",
    "sub": "sub.f32",
    "mul": "mul.f32",
    "div": "div.rn.f32",
    "max": "max.NaN.f32",
    "min": "min.NaN.f32",
    "neg": "neg.f32",
    "abs": "abs.f32",
    "sqrt": "sqrt.rn.f32",
    "round": "cvt.rni.f32.f32",
}
_INTEGER = {
    "add": "add.s32",
    "sub": "sub.s32",
    "mul": "mul.lo.s32",
    "div": "div.s32",
    "rem": "rem.s32",
    "max": "max.s32",
    "min": "min.s32",
    "neg": "neg.s32",
    "abs": "abs.s32",
    "and": "and.b32",
}
_FLAG = {"and": "and.pred", "or": "or.pred", "xor": "xor.pred", "not": "not.pred"}
_OPERATIONS = {"f32": _FLOAT, "s32": _INTEGER, "pred": _FLAG}
_COMPARISONS = ("lt", "le", "gt", "ge", "eq", "ne")
_CONVERSIONS = {("s32", "f32"): "cvt.rn.f32.s32", ("f32", "s32"): "cvt.rzi.s32.f32"}


@dataclasses.dataclass(frozen=True)
class Register:
    """A thread's register.

    Attributes:
        name: as in the text.
        kind: `f32`, `s32`, `pred`, or `u64` for addresses.
    """

    name: str
    kind: str


Element = Register | np.generic
"""A register or a constant."""


def kind_of(dtype: Any) -> str:
    """The kind of registers that hold numbers of a type: float32, int32 or bool."""
    return _KINDS[np.dtype(dtype)]


def _kind(element: Element) -> str:
    return element.kind if isinstance(element, Register) else kind_of(element.dtype)


class PtxWriter:
    """Writes a kernel's instructions one after the other."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._counts = dict.fromkeys(_LETTERS, 0)
        self._labels = 0

    def text(self, name: str, num_arrays: int) -> str:
        """The kernel's text; its arguments are the addresses of `num_arrays` arrays."""
        arguments = ", ".join(f".param .u64 array{index}" for index in range(num_arrays))
        registers = [
            f".reg .{kind} %{letter}<{self._counts[kind] + 1}>;"
            for kind, letter in _LETTERS.items()
        ]
        lines = [*registers, *self._lines, "$end:", "ret;"]
        body = "\n".join(lines)
        return f"{_HEAD}.visible .entry {name}({arguments})\n{{\n{body}\n}}\n"

    def register(self, kind: str) -> Register:
        """A new register."""
        self._counts[kind] += 1
        return Register(f"%{_LETTERS[kind]}{self._counts[kind]}", kind)

    def write(self, line: str) -> None:
        """Adds an instruction or a label."""
        self._lines.append(line)

    def apply(self, instruction: str, kind: str, *operands: Element | str) -> Register:
        """Writes an instruction; its result, in a new register of a kind."""
        result = self.register(kind)
        shown = ", ".join(o if isinstance(o, str) else self.shown(o) for o in operands)
        self.write(f"{instruction} {result.name}, {shown};")
        return result

    def shown(self, element: Element) -> str:
        """The text of an operand."""
        if isinstance(element, Register):
            return element.name
        if isinstance(element, np.bool_):
            flag = self.register("pred")
            self.write(f"setp.eq.s32 {flag.name}, {int(element)}, 1;")
            return flag.name
        if isinstance(element, np.float32):
            return f"0f{element.view(np.uint32):08X}"
        return str(int(element))

    # Threads, and arrays in memory.

    def begin(self, num_threads: int) -> Register:
        """The thread's index; threads from `num_threads` on end at once."""
        block, width, place = (
            self.apply("mov.u32", "s32", name) for name in ("%ctaid.x", "%ntid.x", "%tid.x")
        )
        thread = self.apply("mad.lo.s32", "s32", block, width, place)
        beyond = self.apply("setp.ge.s32", "pred", thread, str(num_threads))
        self.write(f"@{beyond.name} bra $end;")
        return thread

    def address(self, array: int, place: Register, dtype: Any) -> Register:
        """The address of the number at an index of an array."""
        given = self.apply("ld.param.u64", "u64", f"[array{array}]")
        begin = self.apply("cvta.to.global.u64", "u64", given)
        return self.apply("mad.wide.s32", "u64", place, str(_SIZES[kind_of(dtype)]), begin)

    def load(self, address: Register, place: int, dtype: Any) -> Register:
        """Loads the number `place` numbers after an address."""
        kind = kind_of(dtype)
        where = f"[{address.name}+{place * _SIZES[kind]}]"
        if kind != "pred":
            return self.apply(f"ld.global.{kind}", kind, where)
        byte = self.apply("ld.global.u8", "s32", where)
        return self.apply("setp.ne.s32", "pred", byte, "0")

    def store(self, address: Register, place: int, element: Element) -> None:
        """Stores a number `place` numbers after an address."""
        kind = _kind(element)
        where = f"[{address.name}+{place * _SIZES[kind]}]"
        if kind == "pred":
            byte = self.convert(element, "s32")
            self.write(f"st.global.u8 {where}, {self.held(byte).name};")
        else:
            self.write(f"st.global.{kind} {where}, {self.held(element).name};")

    def held(self, element: Element) -> Register:
        """An element in a register."""
        return element if isinstance(element, Register) else self.copied(element)

    def copied(self, element: Element) -> Register:
        """A copy of an element, in a new register."""
        copy = self.register(_kind(element))
        self.move(copy, element)
        return copy

    def move(self, target: Register, element: Element) -> None:
        """Sets a register to an element."""
        if target.kind == "pred" and isinstance(element, np.bool_):
            self.write(f"setp.eq.s32 {target.name}, {int(element)}, 1;")
        else:
            self.write(f"mov.{target.kind} {target.name}, {self.shown(element)};")

    # Operations on numbers.

    def operate(self, name: str, *operands: Element) -> Element:
        """Applies an operation of JAX's name.

        Raises:
            NotImplementedError: if there is no instruction for such operands.
        """
        kind = _kind(operands[0])
        if name in _COMPARISONS and (kind != "pred" or name in ("eq", "ne")):
            if kind == "pred" and name in ("eq", "ne"):
                unequal = self.operate("xor", *operands)
                return unequal if name == "ne" else self.operate("not", unequal)
            # NaN is unequal to everything, also to itself.
            name = "neu" if (name, kind) == ("ne", "f32") else name
            return self.apply(f"setp.{name}.{kind}", "pred", *operands)
        if name not in _OPERATIONS[kind]:
            raise NotImplementedError(f"{name} of {kind} in a kernel")
        return self.apply(_OPERATIONS[kind][name], kind, *operands)

    def choose(self, condition: Element, yes: Element, no: Element) -> Element:
        """One of two values, by a condition."""
        if isinstance(condition, np.bool_):
            return yes if condition else no
        kind = _kind(yes)
        if kind == "pred":
            there = self.operate("and", condition, yes)
            return self.operate(
                "or", there, self.operate("and", self.operate("not", condition), no)
            )
        return self.apply(f"selp.{kind}", kind, yes, no, condition)

    def convert(self, element: Element, kind: str) -> Element:
        """Converts a number to another kind."""
        own = _kind(element)
        if own == kind:
            return element
        if own == "pred":
            number = _NUMBERS[kind]
            return self.choose(element, number(1), number(0))
        if kind == "pred":
            return self.operate("ne", element, _NUMBERS[own](0))
        return self.apply(_CONVERSIONS[own, kind], kind, element)

    # Branches and loops.

    def label(self) -> str:
        """A new label."""
        self._labels += 1
        return f"$place{self._labels}"

    def branch(self, label: str, unless: Element | None = None) -> None:
        """Jumps to a label, or unless a condition holds."""
        guard = "" if unless is None else f"@!{self.shown(unless)} "
        self.write(f"{guard}bra {label};")

    @contextlib.contextmanager
    def loop(self) -> Iterator[str]:
        """Writes a loop around the `with` block; a branch to the yielded label ends the loop."""
        begin, end = self.label(), self.label()
        self.write(f"{begin}:")
        yield end
        self.branch(begin)
        self.write(f"{end}:")

    def move_all(self, targets: Sequence[Register], elements: Sequence[Element]) -> None:
        """Sets registers to elements, all at once: an element may be one of the registers."""
        changed = [
            (target, element)
            for target, element in zip(targets, elements, strict=True)
            if element is not target
        ]
        taken = {target.name for target, _ in changed}
        copies = []
        for target, element in changed:
            if isinstance(element, Register) and element.name in taken:
                element = self.copied(element)
            copies.append((target, element))
        for target, element in copies:
            self.move(target, element)
