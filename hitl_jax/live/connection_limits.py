"""Keeps strangers from starving a page: connections that have not shown the token, and the log.

Who can reach the port need not know the token. So connections without it are few, each ends after a
while whatever it does, and where one more comes the one that has been idle longest goes. A browser
that opens the page needs its own for a moment only.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_STRANGERS = 200
"""Connections without the token at a time."""

PATIENCE = 20.0
"""For how long each may stay [s]."""

_AT_ONCE = 16
"""Connections that are taken in before frames have their turn."""
_QUEUE = 1024
"""Connections that wait to be taken in."""

_LINES, _LINES_SECONDS = 20, 60.0
"""So many lines of log in so many seconds."""

Client = tuple[str, int]


class _Stranger(NamedTuple):
    transport: asyncio.Transport
    timer: asyncio.TimerHandle
    is_answered: Callable[[], bool]


class Doorway:
    """The connections that have not shown the token."""

    def __init__(self, most: int = MOST_STRANGERS, patience: float = PATIENCE):
        """Nobody is there.

        Args:
            most: connections at a time.
            patience: for how long each may stay [s].
        """
        self._most, self._patience = most, patience
        self._strangers: dict[Client, _Stranger] = {}

    def come(self, transport: asyncio.Transport, is_answered: Callable[[], bool]) -> None:
        """Takes a connection in; another one may have to go for it.

        Args:
            transport: of the connection.
            is_answered: whether a request of it is being answered now.
        """
        client = transport.get_extra_info("peername")
        if client is None:  # It is gone already.
            return
        self.admit(client)  # Of an earlier connection from there, which has ended.
        if len(self._strangers) >= self._most:
            idle = (one for one, other in self._strangers.items() if not other.is_answered())
            self._send_away(next(idle, next(iter(self._strangers))))
        timer = asyncio.get_running_loop().call_later(self._patience, self._send_away, client)
        self._strangers[client] = _Stranger(transport, timer, is_answered)

    def admit(self, client: Client) -> None:
        """Lets a connection stay, since it has shown the token."""
        if client in self._strangers:
            self._strangers.pop(client).timer.cancel()

    def _send_away(self, client: Client) -> None:
        stranger = self._strangers.pop(client)
        stranger.timer.cancel()
        stranger.transport.abort()


class FewLines(logging.Filter):
    """Lets so many lines of log pass in a while, and says once that there were more."""

    def __init__(self) -> None:
        """Nothing has been logged."""
        super().__init__()
        self._since, self._lines = -_LINES_SECONDS, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a line is written."""
        now = time.monotonic()
        if now - self._since >= _LINES_SECONDS:
            self._since, self._lines = now, 0
        self._lines += 1
        if self._lines == _LINES:
            record.msg, record.args, record.exc_info = "more of the log is left out", (), None
        return self._lines <= _LINES


class _Server(uvicorn.Server):
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listening in sockets or []:
            listening.listen(_QUEUE)  # Uvicorn has one number for both.


def make_server(app: Any, doorway: Doorway, **options: Any) -> uvicorn.Server:
    """A server whose connections come through a doorway, and whose log is bounded.

    Args:
        app: what it serves.
        doorway: where connections come.
        options: further ones of `uvicorn.Config`.
    """

    class Protocol(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            doorway.come(transport, lambda: bool(self.cycle and not self.cycle.response_complete))

    config = uvicorn.Config(
        app,
        http=Protocol,
        log_level="warning",
        lifespan="off",
        backlog=_AT_ONCE,
        proxy_headers=False,  # Or who shows the token behind a proxy would be known by its name.
        **options,
    )
    few = FewLines()
    for name in ("uvicorn.error", "asyncio", "websockets.server"):
        logger = logging.getLogger(name)
        for old in [one for one in logger.filters if isinstance(one, FewLines)]:
            logger.removeFilter(old)
        logger.addFilter(few)
    return _Server(config)
