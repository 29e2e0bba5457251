"""Writes files and folders atomically, and locks a folder for one writer.

A file is written under a random temporary name beside its final name, flushed to the disk, and
renamed; it is locked while it is written. A killed process can leave temporary files: readers
ignore them, and `remove_leftovers` removes those that no process has locked. Locks are the
operating system's (`flock`): they end with their process, and hold between containers that share a
disk.
"""

import contextlib
import csv
import errno
import fcntl
import os
import pathlib
import platform
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterator, Mapping

from hitl_jax.errors import ResultsError

TEMPORARY = ".tmp-"
"""Beginning of temporary names."""
_TEMPORARY_NAME = re.compile(re.escape(TEMPORARY) + "[0-9a-f]{16}")

LOCK = ".lock"
"""Name of the file that a folder's writer keeps locked."""

LARGEST = 4 * 2**30
"""Largest file that is read [bytes]."""

_LONGEST_REASON = 300
"""Longest error in a message [characters]."""

_held: dict[pathlib.Path, int] = {}
"""Descriptors of the locks that this process holds, by folder."""


def read_bytes(path: pathlib.Path, at_most: int = LARGEST, follow: bool = True) -> bytes:
    """Reads a plain file; refuses a pipe or a device without waiting for it.

    Args:
        path: of the file.
        at_most: largest allowed size [bytes].
        follow: whether a symbolic link is followed; else it is refused.

    Raises:
        ResultsError: if it cannot be read, is too large, or is no plain file.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
    with named_errors(path):
        try:
            descriptor = os.open(path, flags)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.ENXIO):
                raise ResultsError(f"{path}: must be a plain file") from None
            raise
        with open(descriptor, "rb") as file:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise ResultsError(f"{path}: must be a plain file")
            if found.st_size > at_most:
                raise ResultsError(
                    f"{path}: has {found.st_size:,} bytes: must be at most {at_most:,}"
                )
            return file.read(found.st_size + 1)


def write_text_atomic(path: pathlib.Path, text: str) -> None:
    """Writes a text in UTF-8, "?" for invalid characters; see `write_bytes_atomic`."""
    write_bytes_atomic(path, text.encode(errors="replace"))


def write_bytes_atomic(path: pathlib.Path, data: bytes, mode: int = 0o666) -> None:
    """Writes bytes so that `path` always holds the whole old or the whole new ones.

    Args:
        path: of the file.
        data: its content.
        mode: permissions of the new file, before the umask.

    Raises:
        ResultsError: if it cannot be written.
    """
    require_held(path)
    with named_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with _temporary_file(path, mode) as (temporary, descriptor):
            write_synced(descriptor, data)
            os.replace(temporary, path)
        _sync_folder(path.parent)


def write_folder_atomic(path: pathlib.Path, contents: Mapping[str, bytes]) -> None:
    """Makes a folder with all its files, or nothing.

    Args:
        path: of the folder, which must not exist.
        contents: bytes by file name.

    Raises:
        ResultsError: if it cannot be written.
    """
    require_held(path)
    with named_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with _temporary_folder(path) as temporary:
            for name, data in contents.items():
                with open(temporary / name, "xb") as file:
                    write_synced(file.fileno(), data)
            _sync_folder(temporary)
            os.rename(temporary, path)
        _sync_folder(path.parent)


@contextlib.contextmanager
def locked(folder: pathlib.Path) -> Iterator[None]:
    """Locks a folder for this process while the context lasts; makes it if it does not exist.

    The file `LOCK` in it names the process. A file that a killed process left is no obstacle. While
    the lock is held, writing below the folder is refused if the folder was moved or replaced (see
    `require_held`).

    Raises:
        ResultsError: if another process has locked the folder (the message names it), if `LOCK` is
            a link or no file, or if the folder cannot be written.
    """
    path = folder / LOCK
    with named_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise ResultsError(f"{folder}: is a file, not a folder")
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = _open_lock(path)
    name = folder.absolute()
    try:
        with named_errors(path):
            since = time.strftime("%Y-%m-%d %H:%M:%S")
            owner = f"process {os.getpid()} on {platform.node()} since {since}"
            os.ftruncate(descriptor, 0)
            os.write(descriptor, owner.encode(errors="replace"))
        _held[name] = descriptor
        yield
    finally:
        _held.pop(name, None)
        with contextlib.suppress(OSError):  # An error from above says more.
            if is_there(
                path, descriptor
            ):  # Not another process's lock, in a new folder of this name.
                path.unlink()
        os.close(descriptor)


def require_held(path: pathlib.Path) -> None:
    """Checks that a folder that this process has locked is still the one at its path.

    Args:
        path: of what the caller is about to change.

    Raises:
        ResultsError: if the folder was moved or replaced since it was locked.
    """
    for folder, descriptor in _held.items():
        if path.absolute().is_relative_to(folder) and not is_there(folder / LOCK, descriptor):
            raise ResultsError(
                f"{folder}: is not the folder that this process has locked: it was moved, or its "
                f"{LOCK} was removed; nothing more is written there"
            )


def is_there(path: pathlib.Path, descriptor: int) -> bool:
    """Whether the file at a path is the open one."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False


def _open_lock(path: pathlib.Path) -> int:
    """Opens and locks the lock file; returns its descriptor."""
    while True:
        descriptor = open_plain(path, os.O_RDWR | os.O_CREAT, "remove it")
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(descriptor, 1000).decode(errors="replace").partition("\n")[0]
            os.close(descriptor)
            raise ResultsError(
                f"{path.parent}: is in use by {owner or 'another process'}"
            ) from None
        except BaseException:
            os.close(descriptor)
            raise
        # Its owner may have removed the file between open and flock; then our lock is void.
        if is_there(path, descriptor):
            return descriptor
        os.close(descriptor)


def open_plain(path: pathlib.Path, flags: int, advice: str) -> int:
    """Opens a plain file that has no other name (hard link) and is no symbolic link.

    Args:
        path: of the file.
        flags: of `os.open`.
        advice: what the user can do with another kind of file, for the message.

    Returns:
        Its descriptor.

    Raises:
        ResultsError: if it is another kind of file.
        OSError: if it cannot be opened.
    """
    try:
        flags |= os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
            raise _not_plain(path, advice) from None
        raise
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
        os.close(descriptor)
        raise _not_plain(path, advice)
    return descriptor


def _not_plain(path: pathlib.Path, advice: str) -> ResultsError:
    return ResultsError(f"{path}: must be a plain file of one name, or not there: {advice}")


def remove_leftovers(folder: pathlib.Path) -> None:
    """Removes temporary files and folders below a folder that no process is writing."""
    for path in list(folder.rglob(TEMPORARY + "*")):
        if not _TEMPORARY_NAME.fullmatch(path.name) or path.is_symlink():
            continue
        with contextlib.suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
            finally:
                os.close(descriptor)


@contextlib.contextmanager
def named_errors(path: pathlib.Path) -> Iterator[None]:
    """Turns errors of reading, writing or parsing into a ResultsError of one line with `path`."""
    try:
        yield
    except ResultsError:
        raise
    except OSError as error:
        raise ResultsError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise ResultsError(f"{path}: does not fit into memory") from error
    except (ValueError, EOFError, OverflowError, csv.Error) as error:
        raise ResultsError(f"{path}: damaged: {one_line(error)}") from error


def one_line(error: Exception) -> str:
    """An error's message in one line, without control characters, which a terminal would obey."""
    line = " ".join(str(error).split())
    line = "".join(character if character.isprintable() else "?" for character in line)
    return line if len(line) <= _LONGEST_REASON else f"{line[:_LONGEST_REASON]} …"


def _temporary(path: pathlib.Path) -> pathlib.Path:
    """A random temporary name beside a path."""
    return path.with_name(TEMPORARY + secrets.token_hex(8))


@contextlib.contextmanager
def _temporary_file(path: pathlib.Path, mode: int) -> Iterator[tuple[pathlib.Path, int]]:
    """A new, locked file beside a path, and its descriptor; removed after an error."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    while True:
        with _removed_on_errors(_temporary(path)) as temporary:
            descriptor = os.open(temporary, flags, mode)
            with _locked_while_written(descriptor):
                if is_there(temporary, descriptor):  # Another process may have removed it first.
                    yield temporary, descriptor
                    return


@contextlib.contextmanager
def _temporary_folder(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """A new, locked folder beside a path; removed after an error."""
    while True:
        with _removed_on_errors(_temporary(path)) as temporary:
            temporary.mkdir()
            try:
                descriptor = os.open(temporary, os.O_RDONLY | os.O_CLOEXEC)
            except FileNotFoundError:  # Another process removed it before the lock.
                continue
            with _locked_while_written(descriptor):
                if is_there(temporary, descriptor):
                    yield temporary
                    return


@contextlib.contextmanager
def _removed_on_errors(temporary: pathlib.Path) -> Iterator[pathlib.Path]:
    """Removes a temporary file or folder after an error."""
    try:
        yield temporary
    except BaseException:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def _locked_while_written(descriptor: int) -> Iterator[None]:
    """Locks a temporary file against `remove_leftovers` of other processes, and closes it."""
    try:
        with contextlib.suppress(OSError):  # A disk without locks: others cannot lock either.
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def write_synced(descriptor: int, data: bytes) -> None:
    """Writes bytes and flushes them to the disk."""
    with open(descriptor, "wb", closefd=False) as file:
        file.write(data)
    os.fsync(descriptor)


def _sync_folder(path: pathlib.Path) -> None:
    """Flushes a folder's names to the disk, so that a rename survives a loss of power."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
