"""The page and its socket, for browsers on this machine: one controls, any number watch."""

import asyncio
import contextlib
import json
import pathlib
import re
import secrets
import socket
import time

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from hitl_jax.live import messages
from hitl_jax.live.connection_limits import ConnectionLimits, make_server
from hitl_jax.live.pacing import COME_BACK_SECONDS, PacedSession
from hitl_jax.live.page_updates import PageUpdate

MAX_MESSAGE_BYTES = 4096
"""Of a message that a page sends."""

MAX_MESSAGES = 200
"""That a page may send in a second."""

_MAX_INVALID = 20
"""Of these messages, how many may be invalid."""

_PAGE = pathlib.Path(__file__).parent / "page"
_BYTE = r"(?:25[0-5]|2[0-4]\d|1\d\d|[1-9]?\d)"
_HOST = re.compile(
    rf"(localhost|127(?:\.{_BYTE}){{3}}|\[::1\])(?::(\d{{1,5}}))?", re.ASCII | re.IGNORECASE
)
"""A name of this machine that no other machine can have, and a port."""

_PORTS = {"http": 80, "https": 443}
"""Ports that an address may leave out."""

_NO_TOKEN, _TOO_MANY, _TOO_SLOW, _NOT_ALLOWED = 4403, 4429, 4408, 4400
"""Codes with which a socket is closed."""

_MAX_WAITING = 500
"""Updates that may wait for a page."""

_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class _LocalNamesOnly:
    """Refuses requests whose Host is not a name of this machine.

    Otherwise a site whose name resolves to this machine (DNS rebinding) could read the page.
    """

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        app = self._app
        hosts = Headers(scope=scope).getlist("host")
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0]):
            said = "The request's Host must be localhost, 127.x.y.z or [::1], with or without port."
            app = PlainTextResponse(said, 400, headers=_HEADERS)
        await app(scope, receive, send)


def is_same_origin(headers: Headers) -> bool:
    """Whether a request comes from this server's page, or from a program that is no browser.

    A browser sends the origin of the page that asks. It must have the host and port that the
    request names; behind a tunnel they are not the server's own.

    Args:
        headers: of a request for a name of this machine.
    """
    origins = headers.getlist("origin")
    if not origins:
        return True
    scheme, _, name = origins[0].lower().partition("://")
    if len(origins) > 1 or scheme not in _PORTS:
        return False
    origin = _host_and_port(name, scheme)
    return origin is not None and origin == _host_and_port(headers["host"], scheme)


def _host_and_port(host: str, scheme: str) -> tuple[str, int] | None:
    """Name and port, if they are this machine's; else None."""
    found = _HOST.fullmatch(host)
    return found and (found[1].lower(), int(found[2] or _PORTS[scheme]))


class Outbox:
    """Updates that wait to be sent to one page: the newest frame, and all others."""

    def __init__(self) -> None:
        """Begins empty."""
        self._others: list[PageUpdate] = []
        self._frame: PageUpdate | None = None
        self._filled = asyncio.Event()
        self.slow = False

    def put(self, update: PageUpdate) -> None:
        """Adds an update; does not wait."""
        if update["type"] == "frame":
            self._frame = update
        elif update["type"] == "status" and self._others and self._others[-1]["type"] == "status":
            self._others[-1] = update
        elif not self.slow:
            self._others.append(update)
            self.slow = len(self._others) > _MAX_WAITING
        self._filled.set()

    async def take(self) -> list[PageUpdate]:
        """Takes all that waits, as soon as there is something."""
        await self._filled.wait()
        self._filled.clear()
        updates, self._others = self._others, []
        if self._frame is not None:
            updates.append(self._frame)
            self._frame = None
        return updates


class RateLimit:
    """Allows a number of messages a second, and as many at once."""

    def __init__(self, most: float):
        """Begins with all of them allowed.

        Args:
            most: messages a second.
        """
        self._most = self._left = most
        self._then = time.monotonic()

    def allows(self) -> bool:
        """Counts a message; whether it is allowed now."""
        now = time.monotonic()
        self._left = min(self._left + (now - self._then) * self._most, self._most)
        self._then = now
        allowed = self._left >= 1
        self._left -= allowed
        return allowed


class _OpenPage:
    """A page that is open: its socket, its role, and what waits to be sent to it."""

    def __init__(self, socket: WebSocket, controls: bool):
        self.socket, self.controls, self.outbox = socket, controls, Outbox()

    def listen(self, update: PageUpdate) -> None:
        """Takes an update of the session."""
        if update["type"] == "hello":
            update = {**update, "role": "controller" if self.controls else "watcher"}
        self.outbox.put(update)

    def show_error(self, text: str) -> None:
        self.outbox.put({"type": "error", "message": text})


class PageServer:
    """Serves the page of one session."""

    def __init__(self, session: PacedSession, token: str, journal: pathlib.Path):
        """Keeps what it serves.

        Args:
            session: what the page shows.
            token: that the address must carry.
            journal: of the session; a guided person can take a copy away.
        """
        self._session, self._token, self._journal = session, token, journal
        self._limits = ConnectionLimits()
        self._pages: list[_OpenPage] = []
        self._handover: asyncio.TimerHandle | None = None

    def server(self) -> uvicorn.Server:
        """Makes what `serve` takes; its `should_exit` ends it."""
        return make_server(
            self._app(),
            self._limits,
            ws_max_size=MAX_MESSAGE_BYTES,
            timeout_graceful_shutdown=1,
        )

    async def serve(self, server: uvicorn.Server, listening: socket.socket) -> None:
        """Serves the page and plays the session until the server is told to end.

        Raises:
            ResultsError: if the journal cannot be written.
            WalkerError: if the learner diverged.
        """
        # Accepted sockets inherit it. Without it a frame waits up to 40 ms for the acknowledgement
        # of the one before.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        playing = asyncio.create_task(self._session.run())
        playing.add_done_callback(lambda _: setattr(server, "should_exit", True))
        await server.serve(sockets=[listening])
        playing.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await playing

    def _app(self) -> Starlette:
        files = [
            Route(f"/{path.name}", self._serve_file) for path in _PAGE.iterdir() if path.is_file()
        ]
        return Starlette(
            routes=[
                Route("/", self._serve_page),
                Route("/journal", self._serve_journal),
                *files,
                Route("/favicon.ico", _no_content),
                WebSocketRoute("/socket", self._serve_socket),
            ],
            middleware=[Middleware(_LocalNamesOnly)],
        )

    def _is_token(self, token: str | None) -> bool:
        return secrets.compare_digest((token or "").encode(), self._token.encode())

    async def _serve_page(self, request: Request) -> Response:
        if not self._is_token(request.query_params.get("token")):
            said = "This page needs the whole address that `hitl-jax live` printed, with its token."
            return PlainTextResponse(said, 403, headers=_HEADERS)
        return FileResponse(_PAGE / "index.html", headers=_HEADERS)

    async def _serve_journal(self, request: Request) -> Response:
        if not self._is_token(request.query_params.get("token")):
            return PlainTextResponse("The journal needs the address's token.", 403, _HEADERS)
        if not self._session.is_guided:
            return PlainTextResponse("Only a guided session gives its journal.", 404, _HEADERS)
        # Read at once: a file that grows while it is sent would be longer than was announced.
        name = {"Content-Disposition": 'attachment; filename="session.jsonl"'}
        data = self._journal.read_bytes()
        return Response(data, headers=_HEADERS | name, media_type="application/x-ndjson")

    async def _serve_file(self, request: Request) -> Response:
        return FileResponse(_PAGE / request.url.path.lstrip("/"), headers=_HEADERS)

    async def _serve_socket(self, socket: WebSocket) -> None:
        """Serves a page's socket until it closes."""
        await socket.accept()
        if not is_same_origin(socket.headers):
            await socket.close(_NOT_ALLOWED, "another site's page may not speak to this session")
            return
        if not self._is_token(socket.query_params.get("token")):
            reason = "the address needs the token that `hitl-jax live` printed"
            await socket.close(_NO_TOKEN, reason)
            return
        if socket.client is not None:
            self._limits.allow((socket.client.host, socket.client.port))
        page = _OpenPage(socket, controls=not any(other.controls for other in self._pages))
        self._pages.append(page)
        self._session.add_listener(page.listen)
        if page.controls:
            if self._handover is not None:
                self._handover.cancel()
            self._session.connect_person()
        sending = asyncio.create_task(_send(page))
        try:
            await self._receive(page)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            sending.cancel()
            self._pages.remove(page)
            self._session.remove_listener(page.listen)
            if page.controls:
                self._session.disconnect_person()
                loop = asyncio.get_running_loop()
                self._handover = loop.call_later(COME_BACK_SECONDS, self._hand_over)

    def _hand_over(self) -> None:
        """Gives control to the page that has watched longest, if none has it."""
        if self._pages and not any(page.controls for page in self._pages):
            first = self._pages[0]
            first.controls = True
            first.outbox.put({"type": "role", "role": "controller"})
            self._session.connect_person()

    async def _receive(self, page: _OpenPage) -> None:
        """Does what a page says until it closes or breaks a limit."""
        all_messages, invalid = RateLimit(MAX_MESSAGES), RateLimit(_MAX_INVALID)
        while True:
            message = await page.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if not all_messages.allows():
                await page.socket.close(_TOO_MANY, f"more than {MAX_MESSAGES} messages a second")
                return
            try:
                said = messages.parse(message.get("text") or "")
                if page.controls:
                    self._session.handle(said)
                elif said["type"] != "seen":  # Pages that watch answer frames too; it is ignored.
                    raise ValueError("somebody else controls this session; you can watch")
            except ValueError as error:
                page.show_error(str(error))
                if not invalid.allows():
                    reason = f"more than {_MAX_INVALID} messages a second that mean nothing"
                    await page.socket.close(_NOT_ALLOWED, reason)
                    return


async def _no_content(_: Request) -> Response:
    return Response(status_code=204)


async def _send(page: _OpenPage) -> None:
    """Sends what waits for a page; closes one that reads too slowly."""
    socket, outbox = page.socket, page.outbox
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while socket.application_state is WebSocketState.CONNECTED:
            for update in await outbox.take():
                await socket.send_text(json.dumps(update, separators=(",", ":")))
            if outbox.slow:
                await socket.close(_TOO_SLOW, "this page is too slow for the session")
