"""Files that are there whole or not at all.

What is written gets a temporary name beside its final one, is flushed to the disk, and renamed.
Temporary names are drawn at random, and locked while they are written. A killed process can leave
some behind: readers ignore them, and `remove_leftovers` removes those that nobody has locked. Locks
are the operating system's (`flock`): they end with the process, however that ends, and hold between
containers that share a disk.
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
"""How temporary names begin."""
_OURS = re.compile(re.escape(TEMPORARY) + "[0-9a-f]{16}")
"""Temporary names, whole."""

LOCK = ".lock"
"""Name of the file that a folder's one writer holds."""


LARGEST = 4 * 2**30
"""Of a file that is read [bytes]."""

_LONGEST_REASON = 300

_held: dict[pathlib.Path, int] = {}
"""The folders that this process has locked, and the descriptors of their locks."""


def read_bytes(path: pathlib.Path, at_most: int = LARGEST, follow: bool = True) -> bytes:
    """What a plain file holds; a pipe or a device is refused, and not waited for.

    Args:
        path: the file.
        at_most: bytes; a larger file is refused.
        follow: whether it may be a link to the file.

    Raises:
        ResultsError: if it cannot be read, or is none.
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
    """Writes a text so that `path` holds the old one or the whole new one, never a part.

    In UTF-8, whatever the locale; "?" for what is no character, as in a folder's name that is not
    text.

    Raises:
        ResultsError: if it cannot be written.
    """
    write_bytes_atomic(path, text.encode(errors="replace"))


def write_bytes_atomic(path: pathlib.Path, data: bytes, mode: int = 0o666) -> None:
    """Writes bytes as `write_text_atomic` writes text; `mode` says who may read a new file."""
    require_held(path)
    with named_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with _temporary_file(path, mode) as (temporary, descriptor):
            _write_synced(descriptor, data)
            os.replace(temporary, path)
        _sync_folder(path.parent)


def write_folder_atomic(path: pathlib.Path, contents: Mapping[str, bytes]) -> None:
    """Makes a folder with its files, all or nothing.

    Args:
        path: the folder, not there yet.
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
                    _write_synced(file.fileno(), data)
            _sync_folder(temporary)
            os.rename(temporary, path)
        _sync_folder(path.parent)


@contextlib.contextmanager
def locked(folder: pathlib.Path) -> Iterator[None]:
    """Keeps a folder for this process alone; makes it if it is not there.

    The file `LOCK` that a killed process leaves behind keeps nobody out. It says who is at work.
    What this process writes below the folder from then on is refused once the folder's name leads
    to another one (see `require_held`).

    Raises:
        ResultsError: if another process has the folder, naming it; if its lock is a link, or no
            file; or if the folder refuses.
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
        with contextlib.suppress(OSError):  # What led here says more.
            if is_there(path, descriptor):  # Not another's, in a folder that was made anew.
                path.unlink()
        os.close(descriptor)


def require_held(path: pathlib.Path) -> None:
    """To be called before anything is changed in a folder that may be locked by this process.

    Args:
        path: what is to be changed.

    Raises:
        ResultsError: if the folder was moved away since it was locked, or made anew.
    """
    for folder, descriptor in _held.items():
        if path.absolute().is_relative_to(folder) and not is_there(folder / LOCK, descriptor):
            raise ResultsError(
                f"{folder}: is not the folder that this process has locked: it was moved, or its "
                f"{LOCK} was removed; nothing more is written there"
            )


def is_there(path: pathlib.Path, descriptor: int) -> bool:
    """Whether an open file is the one of this name."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False


def _open_lock(path: pathlib.Path) -> int:
    """A descriptor of the lock, which this process alone holds."""
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
        # Its owner may have removed the file between our two calls; then it locks nothing.
        if is_there(path, descriptor):
            return descriptor
        os.close(descriptor)


def open_plain(path: pathlib.Path, flags: int, advice: str) -> int:
    """A descriptor to write with, of a file that nobody has by another name or by a link.

    Args:
        path: the file.
        flags: of `os.open`.
        advice: what to do with another kind of file.

    Raises:
        ResultsError: if it is something else.
        OSError: if the system refuses.
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
    """Removes the temporary files and folders below a folder that nobody is writing any more."""
    for path in list(folder.rglob(TEMPORARY + "*")):
        if not _OURS.fullmatch(path.name) or path.is_symlink():
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
    """Turns errors of files and of what they hold into one line that names `path`."""
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
    """What an error says in one line, without what a terminal would obey."""
    line = " ".join(str(error).split())
    line = "".join(character if character.isprintable() else "?" for character in line)
    return line if len(line) <= _LONGEST_REASON else f"{line[:_LONGEST_REASON]} …"


def _temporary(path: pathlib.Path) -> pathlib.Path:
    return path.with_name(TEMPORARY + secrets.token_hex(8))


@contextlib.contextmanager
def _temporary_file(path: pathlib.Path, mode: int) -> Iterator[tuple[pathlib.Path, int]]:
    """A new, locked file beside a name, and its descriptor; removed if it is not renamed."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    while True:
        with _removed_on_errors(_temporary(path)) as temporary:
            descriptor = os.open(temporary, flags, mode)
            with _locked_as_ours(descriptor):
                if is_there(temporary, descriptor):  # Not removed before it was locked.
                    yield temporary, descriptor
                    return


@contextlib.contextmanager
def _temporary_folder(path: pathlib.Path) -> Iterator[pathlib.Path]:
    """A new, locked folder beside a name; removed if it is not renamed."""
    while True:
        with _removed_on_errors(_temporary(path)) as temporary:
            temporary.mkdir()
            try:
                descriptor = os.open(temporary, os.O_RDONLY | os.O_CLOEXEC)
            except FileNotFoundError:  # Removed before it was locked.
                continue
            with _locked_as_ours(descriptor):
                if is_there(temporary, descriptor):
                    yield temporary
                    return


@contextlib.contextmanager
def _removed_on_errors(temporary: pathlib.Path) -> Iterator[pathlib.Path]:
    try:
        yield temporary
    except BaseException:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def _locked_as_ours(descriptor: int) -> Iterator[None]:
    """Keeps `remove_leftovers` of other processes away."""
    try:
        with contextlib.suppress(OSError):  # A disk without locks: they cannot lock either.
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _write_synced(descriptor: int, data: bytes) -> None:
    with open(descriptor, "wb", closefd=False) as file:
        file.write(data)
    os.fsync(descriptor)


def _sync_folder(path: pathlib.Path) -> None:
    """Makes a rename in this folder survive a loss of power."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
