"""A slow machine for the kernels' text: one thread after the other, each instruction by NumPy.

Threads go on by themselves until they would tell each other something; there all must be at once.
"""

import operator
import re
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

_FLOAT, _INTEGER = np.float32, np.int32
_TYPES = {"f32": np.float32, "s32": np.int32, "u8": np.bool_}
_COMPARED = {
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
    "neu": operator.ne,
}
_COMPUTED: dict[str, Callable] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "neg": operator.neg,
    "max": np.maximum,
    "min": np.minimum,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": operator.not_,
}


WARP = 32


def run(
    text: str, num_threads: int, arrays: Sequence[np.ndarray], block_size: int | None = None
) -> None:
    """Runs a kernel, in one block or in several; what it tells is written into the arrays."""
    body = text[text.index("{") + 1 : text.rindex("}")]
    lines = [line.strip().rstrip(";") for line in body.splitlines()]
    lines = [line for line in lines if line and not line.startswith(".")]
    labels = {line[:-1]: place for place, line in enumerate(lines) if line.endswith(":")}
    flat = [array.reshape(-1) for array in arrays]
    program = [_parsed(line, labels, flat) for line in lines]
    with np.errstate(all="ignore"):
        size = block_size or num_threads
        for block in range(-(-num_threads // size)):
            for first in range(0, size, WARP):
                numbers = range(first, min(first + WARP, size))
                _run_warp(program, [_run_thread(program, block, size, n) for n in numbers])


def _run_warp(program: list, threads: list) -> None:
    """Lets threads go on, each to where it asks the others, again and again."""
    told = [None] * len(threads)
    while asking := {
        lane: asked
        for lane, thread in enumerate(threads)
        if (asked := _next_question(thread, told[lane])) is not None
    }:
        assert len({place for place, _ in asking.values()}) == 1, "threads at different places"
        (place, _), *_ = asking.values()
        values = {lane: value for lane, (_, value) in asking.items()}
        told = [None] * len(threads)
        for lane in asking:
            told[lane] = program[place].answer(lane, values)


def _next_question(thread: Iterator, told: object) -> tuple | None:
    try:
        return thread.send(told)
    except StopIteration:
        return None


def _run_thread(program: list, block: int, size: int, number: int) -> Iterator:
    """Runs a thread; stops where it asks others, with the place and what it tells them."""
    registers = {"%ctaid.x": block, "%ntid.x": size, "%tid.x": number}
    place = 0
    while place < len(program):
        step = program[place]
        if isinstance(step, _Question):
            registers[step.target] = yield place, step.read(registers)
            jump = None
        else:
            jump = None if step is None else step(registers)
        place = place + 1 if jump is None else jump


class _Question(NamedTuple):
    """An instruction by which threads tell each other.

    Attributes:
        target: the register of what is told.
        read: what a thread tells.
        answer: what a lane is told, from what all lanes tell.
    """

    target: str
    read: Callable
    answer: Callable


def _parsed(
    line: str, labels: dict[str, int], arrays: list[np.ndarray]
) -> Callable | _Question | None:
    """What an instruction does: it changes the registers, and may say where to go on."""
    if line.endswith(":"):
        return None
    if line == "ret":
        return lambda _: len(labels) + 10**9
    if match := re.fullmatch(r"(?:@(!?)(%p\d+) )?bra (\S+)", line):
        unless, flag, label = match.groups()
        target = labels[label]
        if flag is None:
            return lambda _: target
        return lambda r: target if bool(r[flag]) != bool(unless) else None
    code, rest = line.split(" ", 1)
    name, *types = code.split(".")
    first, *others = [part.strip() for part in rest.split(",")]
    if code == "shfl.sync.bfly.b32":
        assert others[2:] == ["31", "-1"]
        distance = int(others[1])
        return _Question(first, _operand(others[0]), lambda lane, told: told[lane ^ distance])
    if code == "vote.sync.any.pred":
        assert others[1:] == ["-1"]
        return _Question(first, _operand(others[0]), lambda _, told: any(told.values()))
    if name == "st":
        return _stored(first, _operand(others[0]), types[-1], arrays)
    if name == "ld" and types[0] == "param":
        array = int(re.fullmatch(r"\[array(\d+)\]", others[0])[1])
        return lambda r: r.__setitem__(first, (array, 0))
    if name == "ld":
        return _loaded(first, others[0], types[-1], arrays)
    given = [_operand(part) for part in others]
    work = _work(name, types)
    return lambda r: r.__setitem__(first, work(*(read(r) for read in given)))


def _work(name: str, types: list[str]) -> Callable:
    if name in ("mov", "cvta"):
        return lambda a: a
    if name == "mad":
        if types[0] == "wide":
            return lambda a, b, c: (c[0], c[1] + int(a) * int(b))
        return lambda a, b, c: a * b + c
    if name == "setp":
        return _COMPARED[types[0]]
    if name == "selp":
        return lambda yes, no, condition: yes if condition else no
    if name == "cvt":
        to = _TYPES[types[1]]
        rounded = {"rni": np.rint, "rzi": np.trunc, "rn": lambda a: a}[types[0]]
        return lambda a: to(rounded(a))
    if name == "div":
        return operator.truediv if types[-1] == "f32" else lambda a, b: _INTEGER(int(a / b))
    if name == "rem":
        return lambda a, b: _INTEGER(np.fmod(a, b))
    return _COMPUTED[name]


def _operand(part: str) -> Callable:
    if part.startswith("%"):
        return lambda r: r[part]
    if part.startswith("0f"):
        value = np.uint32(int(part[2:], 16)).view(_FLOAT)
    else:
        value = _INTEGER(int(part))
    return lambda _: value


def _address(part: str) -> Callable:
    name, offset = re.fullmatch(r"\[(%d\d+)\+(\d+)\]", part).groups()
    return lambda r: (r[name][0], r[name][1] + int(offset))


def _loaded(target: str, part: str, kind: str, arrays: list[np.ndarray]) -> Callable:
    address, size = _address(part), np.dtype(_TYPES[kind]).itemsize

    def load(registers: dict) -> None:
        array, place = address(registers)
        value = arrays[array][place // size]
        registers[target] = _INTEGER(value) if kind == "u8" else value

    return load


def _stored(part: str, read: Callable, kind: str, arrays: list[np.ndarray]) -> Callable:
    address, size = _address(part), np.dtype(_TYPES[kind]).itemsize

    def store(registers: dict) -> None:
        array, place = address(registers)
        arrays[array][place // size] = read(registers)

    return store
