"""The journal of a session: a line for each message of the person, and for each chunk.

Lines are only added, and each is written before the session goes on. So a killed process loses at
most the line that it was writing, and the session's last ticks, fewer than a chunk.

The first line is the setup. Each other line has `at`, the number of the frame that came next. A
line of a message has the message (`hitl_jax.live.messages`) and the time. A line at the end of a
chunk has the executed actions (float32, base64) and a checksum of the session. Each line ends with
a checksum of itself and of the lines above.
"""

import base64
import errno
import fcntl
import hashlib
import json
import os
import pathlib
import time
from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from hitl_jax.errors import ResultsError
from hitl_jax.live import messages
from hitl_jax.live.session import Session
from hitl_jax.results.atomic_files import is_there, named_errors, one_line, open_plain, read_bytes
from hitl_jax.results.json_documents import checked, plain_from_json
from hitl_jax.results.schemas import Count, Digest, Positive, Text, Versions

VERSION = 3
_WITHOUT_SUMS = 2
"""An older version, whose lines have no checksums; it can be read and continued."""

_BEGINNINGS = (b'{"journal":3,"', b'{"journal":2,"')
_SUM = b',"sum":"'
_FIRST_SUM = b""

REDIRECT_ENDING = ".open.html"
COMPANION_ENDINGS = (".npz", ".human.npz", REDIRECT_ENDING)
"""Endings of the files that commands write beside a journal: what was learned, the person's
judgements, and the file that leads a browser to the page."""

Line = dict[str, Any]


class Journal:
    """Writes a session's journal.

    Attributes:
        is_new: whether the file was empty; then `begin` must follow.
    """

    def __init__(self, path: pathlib.Path):
        """Opens a journal for this process alone, or makes an empty one.

        A last line that is incomplete is removed.

        Raises:
            ResultsError: if it cannot be written, is a link or no file, or another process writes
                it; or if its name is too long for the files that are written beside it.
        """
        self._path = path
        with named_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            _require_room(path)
            self._file = open_plain(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, "copy it")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            raise ResultsError(f"{path}: another process plays this session") from error
        whole = read_bytes(path)
        # A file that is no journal is not changed.
        if any(whole.startswith(one) or one.startswith(whole) for one in _BEGINNINGS):
            whole = whole[: whole.rfind(b"\n") + 1]
            os.truncate(self._file, len(whole))
        self.is_new = not os.fstat(self._file).st_size
        # A journal of the older version goes on without checksums.
        *_, last = whole[:-1].split(b"\n")
        self._sum = _sum_of(last) if last else _FIRST_SUM

    def begin(self, header: Line) -> None:
        """Writes the first line: the setup.

        Raises:
            ResultsError: if the disk refuses.
        """
        self._add({"journal": VERSION, **header})

    def said(self, session: Session, message: messages.PersonMessage) -> None:
        """Makes a session do what a person said, and writes it down.

        Raises:
            ValueError: one line, where it cannot be done; nothing is written.
            ResultsError: if it cannot be written.
        """
        at = session.frame.number
        more = {}
        if message["type"] in messages.JUDGING:
            more = messages.apply(session, message)
        self._add({"at": at, "said": message, "time": round(time.time(), 3), **more})

    def played(self, session: Session) -> None:
        """Writes the line of a chunk, if one has just ended."""
        at, chunk = session.frame.number, session.setup.loop.chunk
        if at % chunk == 0:
            actions = base64.b64encode(session.actions(at - chunk, at).tobytes()).decode()
            self._add({"at": at, "actions": actions, "digest": session.digest()})

    def close(self) -> None:
        """Closes the file."""
        os.close(self._file)

    def _add(self, line: Line) -> None:
        if not is_there(self._path, self._file):
            raise ResultsError(
                f"{self._path}: was removed, or another file was put in its place, while it was "
                "written: nothing more is noted"
            )
        text = json.dumps(line, separators=(",", ":")).encode()
        after = None
        if self._sum is not None:
            after = next_sum(self._sum, text)
            text = text[:-1] + _SUM + after + b'"}'
        text += b"\n"
        size = os.fstat(self._file).st_size
        try:
            with named_errors(self._path):
                if os.write(self._file, text) < len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except ResultsError:
            os.truncate(self._file, size)
            raise
        self._sum = after


def _require_room(path: pathlib.Path) -> None:
    """Refuses a name that with one of `COMPANION_ENDINGS` would be too long for the file system."""
    most = os.pathconf(path.parent, "PC_NAME_MAX") - max(map(len, COMPANION_ENDINGS))
    if len(os.fsencode(path.name)) > most:
        raise ResultsError(f"{path}: its name must be of at most {most} bytes")


def _sum_of(line: bytes) -> bytes | None:
    """The checksum of a line; None in a version without checksums."""
    _, mark, end = line.rpartition(_SUM)
    return end.removesuffix(b'"}') if mark else None


def next_sum(before: bytes, line: bytes) -> bytes:
    """The checksum of a line.

    Args:
        before: the checksum of the line above.
        line: the text without its checksum.
    """
    return hashlib.blake2b(before + line, digest_size=8).hexdigest().encode()


class _Made(Struct):
    versions: Versions | UnsetType = UNSET
    commit: Text | UnsetType | None = UNSET
    processor: Text | UnsetType = UNSET


class _Head(Struct):
    """The first line; its options are checked where they are used."""

    journal: Literal[2, 3]
    start: Digest | UnsetType | None = UNSET
    human_policy: Digest | UnsetType | None = UNSET
    made: _Made | UnsetType = UNSET


class _Label(Struct, forbid_unknown_fields=True):
    """A `labels.Label` that was taken back."""

    number: int
    kind: Text
    first: int
    last: int | None
    cause: int | None


class _Said(Struct, forbid_unknown_fields=True):
    """The line of a message; `messages` has what it may be."""

    at: Count
    said: dict[Text, Any]
    time: float | UnsetType = UNSET
    label: _Label | UnsetType | None = UNSET


class _Played(Struct, forbid_unknown_fields=True):
    """The line of a chunk."""

    at: Positive
    actions: Annotated[str, Meta(pattern=r"\A[A-Za-z0-9+/=]*\Z")]
    digest: Text


def read(path: pathlib.Path) -> tuple[Line, list[Line]]:
    """Reads the first line of a journal, and the others without an incomplete last one.

    Raises:
        ResultsError: in one line, if it cannot be read, is no journal, or is damaged.
    """
    first, *others = read_bytes(path).split(b"\n")[:-1] or [b""]
    try:
        header = plain_from_json(first, dict[Text, Any])
    except ValueError as error:
        raise ResultsError(f"{path}: is no journal of a live session") from error
    version = header.get("journal")
    if version not in (VERSION, _WITHOUT_SUMS) or isinstance(version, bool | float):
        raise ResultsError(f"{path}: journal {str(version)[:20]!r}: must be {VERSION}")
    before: bytes | None = None if version == _WITHOUT_SUMS else _FIRST_SUM
    read: list[Line] = []
    for number, text in enumerate([first, *others], start=1):
        try:
            line, before = _line(text, before)
            said = number > 1 and "said" in line
            checked(line, _Head if number == 1 else _Said if said else _Played)
            if said:
                messages.require_known(line["said"])
            if number > 2 and line["at"] < read[-1]["at"]:
                raise ValueError("its frame is before that of the line above")
        except ValueError as error:
            raise ResultsError(f"{path}: line {number}: is damaged: {one_line(error)}") from error
        read.append(line)
    return read[0], read[1:]


def kinds(lines: list[Line]) -> set[str]:
    """Types of the messages that these lines have."""
    return {line["said"]["type"] for line in lines if "said" in line}


def _line(text: bytes, before: bytes | None) -> tuple[Line, bytes | None]:
    """Reads a line; gives it without its checksum, and the checksum.

    Args:
        text: of the file.
        before: the checksum of the line above; None in a version without checksums.

    Raises:
        ValueError: in one line, if it is damaged.
    """
    if before is not None:
        content, _, _ = text.rpartition(_SUM)
        if _sum_of(text) != (after := next_sum(before, content + b"}")):
            raise ValueError("its checksum is wrong")
        text, before = content + b"}", after
    line: Line = plain_from_json(text, dict[Text, Any])
    return line, before


def play(
    session: Session,
    lines: list[Line],
    path: pathlib.Path,
    before_step: Callable[[], None] = lambda: None,
) -> Iterator[int]:
    """Plays a journal again on a session of its setup; after each chunk, the frame that comes next.

    Args:
        session: at its beginning.
        lines: of `read`.
        path: of the journal, for error texts.
        before_step: called before each tick.

    Raises:
        ResultsError: if the session does not become what it was.
    """
    chunk = session.setup.loop.chunk
    for line in lines:
        # Every chunk has its line, so the next line is at most a chunk ahead.
        if line["at"] > session.frame.number + chunk:
            raise ResultsError(f"{path}: at frame {line['at']}: lines are missing before it")
        while session.frame.number < line["at"]:
            before_step()
            session.tick()
        if "said" in line:
            if line["said"]["type"] in messages.JUDGING:
                try:
                    messages.apply(session, line["said"])
                except (ValueError, KeyError) as error:
                    raise ResultsError(f"{path}: at frame {line['at']}: {error}") from error
            continue
        yield session.frame.number
        first = line["at"] - chunk
        same = base64.b64encode(session.actions(first, line["at"]).tobytes()).decode()
        if same != line["actions"] or session.digest() != line["digest"]:
            raise ResultsError(
                f"{path}: after frame {first} it plays otherwise than it did; another machine or "
                "another version of JAX rounds otherwise"
            )
