"""Generated damage: of bytes, and of what they mean as JSON, CSV or arrays."""

import io
import json
import random
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from hitl_jax.results.json_documents import FORMAT, _digest

Damage = Callable[[bytes, random.Random], bytes]

SCALARS = (
    None,
    True,
    False,
    -1,
    0,
    1,
    2**31,
    2**53,
    2**63,
    10**30,
    -0.5,
    1e308,
    "",
    "x",
    "0",
    "x" * 200_000,
    "\x1b[2J",
    "a\nb",
    "../../etc/passwd",
    "sha256:" + "0" * 64,
)


# ---------------------------------------------------------------------------------------- bytes


def cut(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data) + 1)]


def cut_at_a_line(data: bytes, chance: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    return b"".join(lines[: chance.randrange(len(lines) + 1)])


def flip_bits(data: bytes, chance: random.Random) -> bytes:
    damaged = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 8, 64))):
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
    return bytes(damaged)


def overwrite(data: bytes, chance: random.Random) -> bytes:
    first = chance.randrange(len(data))
    length = chance.choice((1, 4, 100, 4096))
    filling = chance.choice((chance.randbytes(length), b"\0" * length, b"\xff" * length))
    return data[:first] + filling + data[first + length :]


def repeat_a_piece(data: bytes, chance: random.Random) -> bytes:
    first, last = sorted(chance.randrange(len(data) + 1) for _ in range(2))
    return data[:last] + data[first:last] + data[last:]


def leave_a_piece_out(data: bytes, chance: random.Random) -> bytes:
    first, last = sorted(chance.randrange(len(data) + 1) for _ in range(2))
    return data[:first] + data[last:]


def insert(data: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(data) + 1)
    return data[:place] + chance.choice((b"\0", b",", b"0", b'"', b"\n", b"\xc3")) + data[place:]


def put_in_front(data: bytes, chance: random.Random) -> bytes:
    return chance.choice((b"\xef\xbb\xbf", b"\0", b"\n", b"PK\x03\x04", b"#")) + data


def put_behind(data: bytes, chance: random.Random) -> bytes:
    return data + chance.choice((b"\0", b"\n", b"x", data[-40:], data))


def replace_all(data: bytes, chance: random.Random) -> bytes:
    others = (b"", b"\n", b"{}", b"[]", b"null", b"0", b'"', b"{" * 100_000, b"[" * 100_000)
    deep = b'{"a":' * 100_000 + b"1" + b"}" * 100_000
    return chance.choice(
        (
            *others,
            deep,
            b"9" * 10_000,
            b"\x93NUMPY",
            b"\x80\x04\x95pickle.",
            b"PK\x05\x06" + b"\0" * 18,
        )
    )


OF_BYTES: tuple[Damage, ...] = (
    cut,
    cut_at_a_line,
    flip_bits,
    overwrite,
    repeat_a_piece,
    leave_a_piece_out,
    insert,
    put_in_front,
    put_behind,
    replace_all,
)


# ----------------------------------------------------------------------------------------- JSON


class Place(NamedTuple):
    """A value in a document: the dict or list that has it, and by what."""

    owner: Any
    name: Any


def places(document: Any) -> Iterator[Place]:
    """Every value in a document, outer ones first."""
    names = list(document) if isinstance(document, dict) else range(len(document))
    for name in names:
        yield Place(document, name)
        if isinstance(document[name], dict | list):
            yield from places(document[name])


def kind_of(value: Any) -> str:
    """What JSON calls a value; all numbers are alike."""
    if isinstance(value, bool) or value is None:
        return str(type(value).__name__)
    return "number" if isinstance(value, int | float) else type(value).__name__


def _damage_document(document: Any, chance: random.Random) -> str:
    """Damages a document; what was done, in a few words."""
    owner, name = chance.choice(list(places(document)))
    value = owner[name]
    way = chance.choice(("swap", "swap", "swap", "drop", "rename", "add", "wrap", "deepen", "list"))
    if way == "swap":
        owner[name] = chance.choice(SCALARS)
    elif way == "drop":
        del owner[name]
    elif way == "rename" and isinstance(owner, dict):
        owner[f"{name}x"] = owner.pop(name)
    elif way == "add" and isinstance(owner, dict):
        owner[chance.choice(("unknown", "", "\x1b[1m", "a" * 1000))] = chance.choice(SCALARS)
    elif way == "wrap":
        owner[name] = {"value": value}
    elif way == "deepen":
        for _ in range(chance.choice((5, 50, 900))):
            value = chance.choice(([value], {"a": value}))
        owner[name] = value
    else:
        owner[name] = [value] * chance.choice((0, 1, 3))
    return way


def swap_types(data: bytes, chance: random.Random) -> bytes:
    """Damages a document, and leaves its digest as it was."""
    document = json.loads(data)
    _damage_document(document, chance)
    return json.dumps(document).encode()


def swap_types_and_sign(data: bytes, chance: random.Random) -> bytes:
    """Damages a document, and gives it the digest of what it holds now, as an attacker would."""
    document = json.loads(data)
    document.pop("digest", None)
    _damage_document(document, chance)
    document.pop("digest", None)
    whole = {"format": FORMAT, **document} if isinstance(document, dict) else document
    return json.dumps(whole | {"digest": _digest(whole)}).encode()


def not_numbers(data: bytes, chance: random.Random) -> bytes:
    """NaN, infinities and numbers beyond all floats, which Python's own JSON knows."""
    document = json.loads(data)
    owner, name = chance.choice(list(places(document)))
    owner[name] = "\0here"
    text = chance.choice(("NaN", "Infinity", "-Infinity", "1e999", "1E400", "00", "0x1", "1_0"))
    return json.dumps(document).replace(json.dumps("\0here"), text).encode()


OF_JSON = (swap_types, swap_types_and_sign, not_numbers)


# ------------------------------------------------------------------------------------------ CSV

CELLS = (
    *("", "nan", "inf", "-inf", "-1", "1e300", "1e999", "0x10", "1_0", "1.5", "٣", " 1", "x"),
    *("x" * 200_000, '"', '""', "\x00", "\x1b[2J", "=1+1", "9" * 400, "true", "fall"),
)


def swap_a_cell(data: bytes, chance: random.Random) -> bytes:
    rows = [line.split(",") for line in data.decode().splitlines()]
    row = chance.choice(rows)
    row[chance.randrange(len(row))] = chance.choice(CELLS)
    return "".join(",".join(row) + "\n" for row in rows).encode()


def swap_columns(data: bytes, chance: random.Random) -> bytes:
    rows = [line.split(",") for line in data.decode().splitlines()]
    one, other = (chance.randrange(len(rows[0])) for _ in range(2))
    for row in rows[chance.choice((0, 1)) :]:
        row[one], row[other] = row[other], row[one]
    return "".join(",".join(row) + "\n" for row in rows).encode()


def swap_lines(data: bytes, chance: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    one, other = (chance.randrange(len(lines)) for _ in range(2))
    lines[one], lines[other] = lines[other], lines[one]
    return b"".join(lines)


def repeat_a_line(data: bytes, chance: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    return b"".join([*lines, *[chance.choice(lines)] * chance.choice((1, 3))])


OF_CSV: tuple[Damage, ...] = (swap_a_cell, swap_a_cell, swap_columns, swap_lines, repeat_a_line)


# --------------------------------------------------------------------------------------- arrays


def swap_arrays(data: bytes, chance: random.Random) -> bytes:
    """Arrays of other types, shapes, sizes or names; whole by what zip and NumPy can tell."""
    with np.load(io.BytesIO(data)) as archive:
        arrays: dict[str, Any] = {name: archive[name] for name in archive.files}
    name = chance.choice(list(arrays))
    array = arrays[name]
    way = chance.randrange(12)
    if way == 0:
        del arrays[name]
    elif way == 1:
        arrays[chance.choice((name + "x", "unknown", "../" + name, name + "/" + name))] = array
    elif way == 2:
        arrays["renamed"] = arrays.pop(name)
    elif way == 3:
        kinds = ("float64", "int32", "uint8", "bool", "complex64", "S3", "U3", "M8[s]", "float16")
        arrays[name] = np.zeros(array.shape, chance.choice(kinds))
    elif way == 4:
        arrays[name] = array[None]
    elif way == 5:
        arrays[name] = array.reshape(-1)
    elif way == 6:
        arrays[name] = array[..., :0] if array.ndim else np.zeros(0, array.dtype)
    elif way == 7 and array.dtype.kind == "f" and array.size:
        arrays[name] = array.copy()
        arrays[name].flat[chance.randrange(array.size)] = chance.choice((np.nan, np.inf, -np.inf))
    elif way == 8:
        arrays[name] = np.concatenate([np.atleast_1d(array)] * 3)
    elif way == 9:  # Eighty megabytes, packed to some kilobytes.
        arrays[name] = np.zeros((20_000_000,), np.float32)
    elif way == 10:
        arrays[name] = np.array([{"a": 1}], dtype=object)
    else:
        arrays[name] = np.zeros(3, [("a", np.float32), ("b", np.int8)])
    file = io.BytesIO()
    save = np.savez_compressed if way == 9 else np.savez
    save(file, allow_pickle=True, **arrays)
    return file.getvalue()


def lie_about_shapes(data: bytes, chance: random.Random) -> bytes:
    """Headers that promise more, less or something else than there is."""
    first = data.find(b"'shape': (")
    if first < 0:
        return cut(data, chance)
    lies = (b"999999999, 99", b"-1, -1", b"0", b"1.5", b"10**9", b"'a'", b"(((((", b"None")
    lie = chance.choice(lies)
    return data[: first + 10] + lie + data[first + 10 + len(lie) :]


OF_ARRAYS: tuple[Damage, ...] = (swap_arrays, swap_arrays, lie_about_shapes)
