"""Limits connections that have not shown the token, and lines of log, so that the page stays fast.

Programs that can reach the port need not know the token. So connections without it are limited in
number and in time, and one more closes the one that has been idle longest. A browser that opens the
page needs such a connection for a moment only.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_CONNECTIONS = 200
"""Connections without the token at a time."""

MAX_SECONDS = 20.0
"""How long each may stay [s]."""

_ACCEPTED_AT_ONCE = 16
"""Connections that are accepted before frames have their turn."""
_QUEUE = 1024
"""Connections that wait to be accepted."""

_LOG_LINES, _LOG_SECONDS = 20, 60.0
"""At most so many lines of log in so many seconds."""

Client = tuple[str, int]


class _Connection(NamedTuple):
    transport: asyncio.Transport
    timer: asyncio.TimerHandle
    is_answered: Callable[[], bool]


class ConnectionLimits:
    """Closes connections that have not shown the token, when they are too many or too old."""

    def __init__(self, most: int = MAX_CONNECTIONS, seconds: float = MAX_SECONDS):
        """Begins without connections.

        Args:
            most: connections at a time.
            seconds: how long each may stay [s].
        """
        self._most, self._seconds = most, seconds
        self._connections: dict[Client, _Connection] = {}

    def add(self, transport: asyncio.Transport, is_answered: Callable[[], bool]) -> None:
        """Adds a connection; may close another one for it.

        Args:
            transport: of the connection.
            is_answered: whether a request of it is being answered now.
        """
        client = transport.get_extra_info("peername")
        if client is None:  # It is closed already.
            return
        self.allow(client)  # An earlier connection with this address has ended.
        if len(self._connections) >= self._most:
            idle = (one for one, other in self._connections.items() if not other.is_answered())
            self._close(next(idle, next(iter(self._connections))))
        timer = asyncio.get_running_loop().call_later(self._seconds, self._close, client)
        self._connections[client] = _Connection(transport, timer, is_answered)

    def allow(self, client: Client) -> None:
        """Lifts the limits from a connection, since it has shown the token."""
        if client in self._connections:
            self._connections.pop(client).timer.cancel()

    def _close(self, client: Client) -> None:
        connection = self._connections.pop(client)
        connection.timer.cancel()
        connection.transport.abort()


class LogLimit(logging.Filter):
    """Passes a limited number of log lines a minute, and says once that there were more."""

    def __init__(self) -> None:
        """Begins with nothing logged."""
        super().__init__()
        self._since, self._lines = -_LOG_SECONDS, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a line is written."""
        now = time.monotonic()
        if now - self._since >= _LOG_SECONDS:
            self._since, self._lines = now, 0
        self._lines += 1
        if self._lines == _LOG_LINES:
            record.msg, record.args, record.exc_info = "more of the log is left out", (), None
        return self._lines <= _LOG_LINES


class _Server(uvicorn.Server):
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listening in sockets or []:
            # Uvicorn's `backlog` sets this as well as how many are accepted at once.
            listening.listen(_QUEUE)


def make_server(app: Any, limits: ConnectionLimits, **options: Any) -> uvicorn.Server:
    """A server with limited connections and a limited log.

    Args:
        app: what it serves.
        limits: of connections that have not shown the token.
        options: further ones of `uvicorn.Config`.
    """

    class Protocol(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            limits.add(transport, lambda: bool(self.cycle and not self.cycle.response_complete))

    config = uvicorn.Config(
        app,
        http=Protocol,
        log_level="warning",
        lifespan="off",
        backlog=_ACCEPTED_AT_ONCE,
        proxy_headers=False,  # Or a proxy's header would hide which connection showed the token.
        **options,
    )
    limit = LogLimit()
    for name in ("uvicorn.error", "asyncio", "websockets.server"):
        logger = logging.getLogger(name)
        for old in [one for one in logger.filters if isinstance(one, LogLimit)]:
            logger.removeFilter(old)
        logger.addFilter(limit)
    return _Server(config)
