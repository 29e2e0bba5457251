"""A live page beside a crowd: connections of strangers that never finish their request."""

import contextlib
import resource
import selectors
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator

CROWD = 2_000
_BEGUN = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-"
_PAUSE = 0.05


@contextlib.contextmanager
def crowd(port: int, size: int = CROWD) -> Iterator[None]:
    """Keeps so many connections open; where one is closed, another is opened.

    Args:
        port: of the page, on this machine.
        size: of the crowd, as far as the system lets this process have files.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(size + 500, hard), hard))
    over = threading.Event()
    gathered = threading.Thread(target=_gather, args=(port, size, over))
    gathered.start()
    try:
        yield
    finally:
        over.set()
        gathered.join()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def _gather(port: int, size: int, over: threading.Event) -> None:
    with selectors.DefaultSelector() as there:
        while not over.wait(_PAUSE):
            for key, _ in there.select(timeout=0):
                there.unregister(key.fileobj)
                with contextlib.suppress(OSError):
                    key.fileobj.close()  # type: ignore[union-attr]
            while len(there.get_map()) < size and not over.is_set():
                try:
                    one = socket.create_connection(("127.0.0.1", port), timeout=1.0)
                    one.sendall(_BEGUN)
                except OSError:
                    break
                there.register(one, selectors.EVENT_READ)
        for key in list(there.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]


def seconds_of_page(address: str) -> float:
    """How long a new page takes [s].

    Args:
        address: with the token.
    """
    began = time.perf_counter()
    with urllib.request.urlopen(address, timeout=30) as answer:
        answer.read()
    return time.perf_counter() - began
