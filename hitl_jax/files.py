"""Files that are there whole or not at all.

What is written gets a temporary name beside its final one, is flushed to the disk, and renamed. A
killed process can leave temporary names behind; readers ignore them and `remove_leftovers` removes
them. A final name has one writer at a time.
"""

import contextlib
import fcntl
import os
import pathlib
import platform
import shutil
import time
import zipfile
from collections.abc import Iterator, Mapping
from typing import TextIO

TEMPORARY = ".tmp-"
"""How temporary names begin."""

LOCK = ".lock"
"""Name of the file that a folder's one writer holds."""


class ResultsError(ValueError):
    """Results that cannot be used; the message is one line naming the file."""


def write_text_atomic(path: pathlib.Path, text: str) -> None:
    """Writes a text so that `path` holds the old one or the whole new one, never a part.

    In UTF-8, whatever the locale; "?" for what is no character, as in a folder's name that is not
    text.

    Raises:
        ResultsError: if it cannot be written.
    """
    write_bytes_atomic(path, text.encode(errors="replace"))


def write_bytes_atomic(path: pathlib.Path, data: bytes) -> None:
    """Writes bytes as `write_text_atomic` writes text."""
    temporary = _temporary(path)
    with named_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            _write_synced(temporary, data)
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)


def write_folder_atomic(path: pathlib.Path, contents: Mapping[str, bytes]) -> None:
    """Makes a folder with its files, all or nothing.

    Args:
        path: the folder, not there yet.
        contents: bytes by file name.

    Raises:
        ResultsError: if it cannot be written.
    """
    temporary = _temporary(path)
    with named_errors(path):
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        try:
            for name, data in contents.items():
                _write_synced(temporary / name, data)
            _sync_folder(temporary)
            os.rename(temporary, path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        _sync_folder(path.parent)


@contextlib.contextmanager
def locked(folder: pathlib.Path) -> Iterator[None]:
    """Keeps a folder for this process alone; makes it if it is not there.

    The lock is the operating system's (`flock`): it ends with the process, however that ends, so
    the file `LOCK` that a killed process leaves behind keeps nobody out. It says who is at work.

    Raises:
        ResultsError: if another process has the folder, naming it; or if the folder refuses.
    """
    path = folder / LOCK
    with named_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise ResultsError(f"{folder}: is a file, not a folder")
        folder.mkdir(parents=True, exist_ok=True)
        file = _open_lock(path)
    with file:
        try:
            with named_errors(path):
                since = time.strftime("%Y-%m-%d %H:%M:%S")
                owner = f"process {os.getpid()} on {platform.node()} since {since}"
                # Past the buffer, which on a full disk would fail once more when it is closed.
                os.ftruncate(file.fileno(), 0)
                os.write(file.fileno(), owner.encode(errors="replace"))
            yield
        finally:
            with contextlib.suppress(OSError):  # What led here says more.
                if _is_there(path, file):  # Not another's, in a folder that was made anew.
                    path.unlink()


def _is_there(path: pathlib.Path, file: TextIO) -> bool:
    """Whether an open file is the one of this name."""
    return path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())


def _open_lock(path: pathlib.Path) -> TextIO:
    while True:
        file = open(path, "a+", encoding="utf-8", errors="replace")  # noqa: SIM115, the caller closes it
        file.seek(0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            with file:
                owner = file.readline() or "another process"
            raise ResultsError(f"{path.parent}: is in use by {owner}") from None
        except BaseException:
            file.close()
            raise
        # Its owner may have removed the file between our two calls; then it locks nothing.
        if _is_there(path, file):
            return file
        file.close()


def remove_leftovers(folder: pathlib.Path) -> None:
    """Removes the temporary files and folders below a folder that nobody is writing to."""
    for path in list(folder.rglob(TEMPORARY + "*")):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def named_errors(path: pathlib.Path) -> Iterator[None]:
    """Turns errors of files and of what they hold into one line that names `path`."""
    try:
        yield
    except ResultsError:
        raise
    except OSError as error:
        raise ResultsError(f"{path}: {error.strerror or error}") from error
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ResultsError(f"{path}: damaged: {' '.join(str(error).split())}") from error


def _temporary(path: pathlib.Path) -> pathlib.Path:
    """Another name for each process: figures may be drawn twice at a time."""
    return path.with_name(f"{TEMPORARY}{os.getpid()}-{path.name}")


def _write_synced(path: pathlib.Path, data: bytes) -> None:
    with open(path, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(path: pathlib.Path) -> None:
    """Makes a rename in this folder survive a loss of power."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
