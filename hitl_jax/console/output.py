"""Prints text as it is, in any encoding, also into a closed pipe."""

from __future__ import annotations

import errno
import io
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

_STRICT = ("strict", "surrogateescape")


def replace_what_cannot_be_encoded() -> None:
    """Makes standard output and error show "?" for what their encoding lacks.

    A terminal may know ASCII alone, and a folder's name may be no text at all; neither may end the
    work. A stream that cannot be told so, as a notebook's, stays as it is.
    """
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) in _STRICT and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


class _Unread(io.RawIOBase):
    """A stream whose reader may go away: what is written then is dropped.

    Args:
        stream: the raw stream.
        note: what standard error is told then, once; nothing if it is empty.
    """

    def __init__(self, stream: io.FileIO, note: str):
        self._stream = stream
        self._note = note

    def writable(self) -> bool:
        """Always."""
        return True

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """The descriptor."""
        return self._stream.fileno()

    def write(self, data: Any) -> int | None:
        """Writes, or drops what nobody can read: of a pipe that is closed, a terminal that is."""
        try:
            return self._stream.write(data)
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.EIO):
                raise
            note, self._note = self._note, ""
            if note:
                print(note, file=sys.stderr, flush=True)
            return memoryview(data).nbytes


def go_on_without_readers() -> None:
    """Lets the work go on where standard output or error is a pipe that nobody reads any more.

    `hitl-jax sweep | head -1` ends after its last run, not in the middle of one. Streams that are
    no text of a file's descriptor, as a notebook's, stay as they are.
    """
    note = "nobody reads standard output any more: going on without it"
    for name, told in (("stdout", note), ("stderr", "")):
        stream = getattr(sys, name)
        buffer = getattr(stream, "buffer", None)
        raw = getattr(buffer, "raw", buffer)  # With `python -u` there is no buffer between.
        if type(stream) is io.TextIOWrapper and isinstance(raw, io.FileIO):
            stream.flush()
            unread: Any = _Unread(raw, told)
            new = io.TextIOWrapper(
                unread if raw is buffer else io.BufferedWriter(unread),
                encoding=stream.encoding,
                errors=stream.errors,
                line_buffering=stream.line_buffering,
                write_through=stream.write_through,
            )
            setattr(sys, name, new)


def plain_console(width: int | None = None) -> Console:
    """A console for tables that shows text as it is: no "[red]" and no ":smile:" means anything.

    Args:
        width: in characters; None is the terminal's.
    """
    from rich.console import Console  # Not for `hitl-jax --help`: it takes time.

    return Console(width=width, markup=False, emoji=False, highlight=False)


def say(line: str) -> None:
    """Prints a line at once, also where standard output is a pipe."""
    print(line, flush=True)


def print_rows(title: str, rows: list[dict[str, Any]]) -> None:
    """Prints a table; columns of words stand to the left."""
    from rich.table import Table

    names = list(dict.fromkeys(name for row in rows for name in row))
    table = Table(title=title, title_justify="left")
    for name in names:
        words = all(isinstance(row.get(name, ""), str) for row in rows)
        table.add_column(name, justify="left" if words else "right")
    for row in rows:
        table.add_row(*(str(row.get(name, "")) for name in names))
    plain_console(None if sys.stdout.isatty() else 120).print(table)
