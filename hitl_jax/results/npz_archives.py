"""Arrays as npz files; what they hold is looked at before it is unpacked (host, NumPy).

Nothing is executed (no pickle), and no more memory is taken than the caller allows.
"""

import io
import math
import warnings
import zipfile
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

STORED = 4
"""How many times its size a file may unpack to that was written without compression."""

_MOST_DIMENSIONS = 8
_MOST_ARRAYS = 100_000
_LONGEST_NAME = 500
_SMALL = 2**20
"""That a file may always unpack to [bytes]."""
_KINDS = "biuf"
_WIDEST = 8
"""Of a number [bytes]."""
_BEGINS, _END, _END_SIZE = b"PK\x03\x04", b"PK\x05\x06", 22
"""Of an archive without comment: what stands before its first array, and what ends it [bytes]."""
_PIECE = 2**20
"""That is read at a time [bytes]."""


class Form(NamedTuple):
    """What an array is, before it is read.

    Attributes:
        shape: of the array.
        dtype: of its numbers.
    """

    shape: tuple[int, ...]
    dtype: np.dtype


class Member(NamedTuple):
    """An array of an archive, not read yet: its entry, what it is, and where its numbers begin."""

    entry: zipfile.ZipInfo
    form: Form
    columns_first: bool
    start: int


def to_npz(arrays: Mapping[str, Any], save: Callable[..., None] = np.savez) -> bytes:
    """Arrays as a file's bytes; `save` is `np.savez` or `np.savez_compressed`."""
    archive = io.BytesIO()
    save(archive, allow_pickle=False, **arrays)
    return archive.getvalue()


def from_npz(
    data: bytes,
    at_most: int | None = None,
    require: Callable[[dict[str, Form]], None] = lambda forms: None,
) -> dict[str, np.ndarray]:
    """The arrays of a file by name.

    Args:
        data: of the file.
        at_most: bytes that it may unpack to; by default `STORED` times its size.
        require: is shown what the file says that it holds, and raises ValueError unless that is
            what it should.

    Raises:
        ValueError: one line saying what is wrong.
    """
    end = len(data) - _END_SIZE
    if not data.startswith(_BEGINS if end else _END) or not data.startswith(_END, max(end, 0)):
        raise ValueError("is no archive of arrays, or more than one")
    limit = max(STORED * len(data), _SMALL) if at_most is None else at_most
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = _members(archive, limit)
            require({name: member.form for name, member in members.items()})
            return {name: _read(archive, member) for name, member in members.items()}
    except ValueError:
        raise
    except Exception as error:  # A flipped bit can make of zipfile's and NumPy's errors any.
        raise ValueError(f"{type(error).__name__}: {error}") from error


def _members(archive: zipfile.ZipFile, limit: int) -> dict[str, Member]:
    entries = archive.infolist()
    if len(entries) > _MOST_ARRAYS:
        raise ValueError(f"holds {len(entries)} arrays: must be at most {_MOST_ARRAYS}")
    size = sum(entry.file_size for entry in entries)
    if size > limit:
        raise ValueError(f"unpacks to {size:,} bytes: must be at most {limit:,}")
    members = {}
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        if name == entry.filename or name in members or len(name) > _LONGEST_NAME:
            raise ValueError(f"entry {entry.filename[:50]!r}: must be an array, once")
        members[name] = _member(archive, entry)
    return members


def _member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Member:
    """What an entry says that it holds."""
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        if version != (1, 0):
            raise ValueError(f"array {entry.filename!r}: is of npy's version {version}")
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Of headers that Python 2 wrote, or nobody.
            shape, columns_first, dtype = np.lib.format.read_array_header_1_0(file)
        start = file.tell()
    if dtype.kind not in _KINDS or not dtype.isnative or dtype.itemsize > _WIDEST:
        raise ValueError(f"array {entry.filename!r}: is of {dtype}, no numbers")
    if len(shape) > _MOST_DIMENSIONS or any(side < 0 for side in shape):
        raise ValueError(f"array {entry.filename!r}: has shape {shape}"[:200])
    if math.prod(shape) * dtype.itemsize != entry.file_size - start:
        raise ValueError(f"array {entry.filename!r}: has another size than its shape says")
    return Member(entry, Form(shape, dtype), columns_first, start)


def _read(archive: zipfile.ZipFile, member: Member) -> np.ndarray:
    numbers = np.empty(math.prod(member.form.shape), member.form.dtype)
    with archive.open(member.entry) as file:
        file.read(member.start)
        buffer = memoryview(numbers.view(np.uint8))
        while piece := file.read(_PIECE):  # To the end, or its checksum is not looked at.
            buffer[: len(piece)] = piece
            buffer = buffer[len(piece) :]
        if len(buffer):
            raise ValueError(f"array {member.entry.filename!r}: is cut short")
    if numbers.dtype == bool and (numbers.view(np.uint8) > 1).any():
        raise ValueError(f"array {member.entry.filename!r}: holds truth values that are none")
    return numbers.reshape(member.form.shape, order="F" if member.columns_first else "C")
