"""The journal of a session: a line for each thing that was done to it, and for each chunk.

Lines are only added, and each is the system's before the next thing happens. So a killed process
loses at most the line that it was writing, and the session's last ticks, fewer than a chunk.

The first line is the setup. Then, by `at`, the frame that came next: what a person said, as
`hitl_jax.live.commands` has it, with the time; and at the end of a chunk the actions that were
executed (float32, base64) and a checksum.
"""

import base64
import errno
import fcntl
import json
import os
import pathlib
import time
from collections.abc import Callable, Iterator
from typing import Any

from hitl_jax.files import ResultsError, named_errors
from hitl_jax.live import commands
from hitl_jax.live.session import Session

VERSION = 2
_BEGINNING = b'{"journal":'

Line = dict[str, Any]


class Journal:
    """Writes a session's journal.

    Attributes:
        is_new: whether nothing was in it; then it is to `begin`.
    """

    def __init__(self, path: pathlib.Path):
        """Opens it for this process alone, or makes an empty one.

        A last line that was not written to its end is taken off.

        Raises:
            ResultsError: if it cannot be written, or another process writes it.
        """
        self._path = path
        with named_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            raise ResultsError(f"{path}: another process plays this session") from error
        whole = path.read_bytes()
        beginning = whole[: len(_BEGINNING)]
        if beginning == _BEGINNING[: len(beginning)]:  # Not of a file that is something else.
            os.truncate(self._file, whole.rfind(b"\n") + 1)
        self.is_new = not os.fstat(self._file).st_size

    def begin(self, header: Line) -> None:
        """Writes the first line: the setup.

        Raises:
            ResultsError: if the disk refuses.
        """
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
        size = os.fstat(self._file).st_size
        try:
            with named_errors(self._path):
                if os.write(self._file, text) < len(text):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except ResultsError:
            os.truncate(self._file, size)
            raise


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
    except ResultsError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"{path}: is no journal of a live session") from error
    for number, line in enumerate(others, start=2):
        if not _is_line(line):
            raise ResultsError(f"{path}: line {number}: is damaged")
    return header, others


def _is_line(line: Any) -> bool:
    if not isinstance(line, dict) or type(line.get("at")) is not int:
        return False
    said = line.get("said")
    return "type" in said if isinstance(said, dict) else {"actions", "digest"} <= line.keys()


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
                try:
                    commands.apply(session, line["said"])
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
