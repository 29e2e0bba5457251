"""The journal of a session: a line for each thing that was done to it, and for each chunk.

Lines are only added, and each is on the disk before the next thing happens. So a killed process
loses at most the line that it was writing, and the session's last ticks, fewer than a chunk.

The first line is the setup. Then, by `at`, the frame that came next: what a person said, as
`hitl_jax.live.commands` has it, with the time; and at the end of a chunk the actions that were
executed (float32, base64) and a checksum.
"""

import base64
import fcntl
import json
import os
import pathlib
import time
from collections.abc import Callable, Iterator
from typing import Any

from hitl_jax.files import ResultsError
from hitl_jax.live import commands
from hitl_jax.live.session import Session

VERSION = 1

Line = dict[str, Any]


class Journal:
    """Writes a session's journal."""

    def __init__(self, path: pathlib.Path, header: Line | None):
        """Opens it.

        Args:
            path: the file.
            header: the setup, for a new one; None goes on with what is there, less a line that was
                not written to its end.

        Raises:
            ResultsError: if it cannot be written, or another process writes it.
        """
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_APPEND | (0 if header is None else os.O_CREAT | os.O_EXCL)
            self._file = os.open(path, flags, 0o644)
        except OSError as error:
            raise ResultsError(f"{path}: {error.strerror}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._file)
            raise ResultsError(f"{path}: another process plays this session") from error
        if header is None:
            whole = path.read_bytes().rpartition(b"\n")
            os.truncate(path, len(whole[0]) + len(whole[1]))
        if header is not None:
            self._add({"journal": VERSION, **header})

    def said(self, session: Session, command: commands.Command) -> None:
        """Does to a session what a person said, and notes it.

        Raises:
            ValueError: one line, where it cannot be done; nothing is noted.
        """
        at = session.frame.number
        beside = {}
        if command["type"] in commands.JUDGING:
            beside = commands.apply(session, command)
        self._add({"at": at, "said": command, "time": round(time.time(), 3), **beside})

    def played(self, session: Session) -> None:
        """Notes a chunk, if one has just ended."""
        at, chunk = session.frame.number, session.setup.loop.chunk
        if at % chunk == 0:
            actions = base64.b64encode(session.actions(at - chunk, at).tobytes()).decode()
            self._add({"at": at, "actions": actions, "digest": session.digest()})

    def close(self) -> None:
        """No more will come."""
        os.close(self._file)

    def _add(self, line: Line) -> None:
        text = json.dumps(line, separators=(",", ":")).encode() + b"\n"
        try:
            if os.write(self._file, text) == len(text):
                return
        except OSError as error:
            raise ResultsError(f"{self._path}: {error.strerror}") from error
        raise ResultsError(f"{self._path}: No space left on device")


def read(path: pathlib.Path) -> tuple[Line, list[Line]]:
    """The first line of a journal, and the others but for a last one that is not whole.

    Raises:
        ResultsError: in one line, if it cannot be read or is no journal.
    """
    try:
        text = path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        said = getattr(error, "strerror", None) or "is no journal of a live session"
        raise ResultsError(f"{path}: {said}") from error
    lines = text.split("\n")[:-1]
    try:
        header, *others = [json.loads(line) for line in lines]
        if header["journal"] != VERSION:
            raise ResultsError(f"{path}: journal {header['journal']}: must be {VERSION}")
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, ResultsError):
            raise
        raise ResultsError(f"{path}: is no journal of a live session") from error
    return header, others


def play(
    session: Session,
    lines: list[Line],
    path: pathlib.Path,
    before_step: Callable[[], None] = lambda: None,
) -> Iterator[int]:
    """Plays a journal again on a session of its setup; gives the frame that comes next, at times.

    Args:
        session: at its beginning.
        lines: of `read`.
        path: for what is said.
        before_step: called before each tick.

    Raises:
        ResultsError: if the session does not become what it was.
    """
    chunk = session.setup.loop.chunk
    for line in lines:
        while session.frame.number < line["at"]:
            before_step()
            session.tick()
        if "said" in line:
            if line["said"]["type"] in commands.JUDGING:
                commands.apply(session, line["said"])
            continue
        yield session.frame.number
        first = line["at"] - chunk
        same = base64.b64encode(session.actions(first, line["at"]).tobytes()).decode()
        if same != line["actions"] or session.digest() != line["digest"]:
            raise ResultsError(
                f"{path}: after frame {first} it plays otherwise than it did; another machine or "
                "another version of JAX rounds otherwise"
            )
