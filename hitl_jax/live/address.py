"""Where the page is, and how this machine's browser comes to it."""

import contextlib
import os
import pathlib
import socket
import sys
import webbrowser
from collections.abc import Iterator

from hitl_jax.errors import InvalidValue
from hitl_jax.live.journal import REDIRECT_ENDING
from hitl_jax.results.atomic_files import write_bytes_atomic

HOST = "127.0.0.1"


def listen(port: int) -> socket.socket:
    """A socket of this machine alone on which the page is served.

    Args:
        port: 0 takes any.

    Raises:
        InvalidValue: one line, if it cannot be had.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((HOST, port))
        listening.listen()  # A page that is opened at once waits.
    except OSError as error:
        listening.close()
        raise InvalidValue("port", port, str(error.strerror)) from error
    return listening


@contextlib.contextmanager
def opened(address: str, path: pathlib.Path) -> Iterator[None]:
    """Opens an address in the browser, which others on this machine cannot see.

    They see the command lines of its processes, and this has the token in it. So the browser gets a
    file that only the user can read, and that sends it on. The file is there while the page is.

    Args:
        address: with the token.
        path: of the journal; the file is put beside it.
    """
    door = path.absolute().with_name(path.name + REDIRECT_ENDING)
    # Not in a hidden folder, nor in /tmp: a browser in a container may not read there.
    page = f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">\n'
    write_bytes_atomic(door, page.encode(), mode=0o600)
    try:
        webbrowser.open(door.as_uri())
        yield
    finally:
        with contextlib.suppress(OSError):
            door.unlink()


def has_display() -> bool:
    """Whether this process can show a browser."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or sys.platform in ("darwin", "win32")
