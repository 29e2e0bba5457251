"""The page and its socket, for browsers on this machine: one who controls, any number who watch."""

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

from hitl_jax.live import messages as commands
from hitl_jax.live.connection_limits import Doorway, make_server
from hitl_jax.live.pacing import Conductor, Message

LONGEST_MESSAGE = 4096
"""Of what a page may send [bytes]."""

MOST_MESSAGES = 200
"""That a page may send in a second."""

_PATIENCE = 20
"""How many of them may mean nothing."""

_PAGE = pathlib.Path(__file__).parent / "page"
_BYTE = r"(?:25[0-5]|2[0-4]\d|1\d\d|[1-9]?\d)"
_HOST = re.compile(
    rf"(localhost|127(?:\.{_BYTE}){{3}}|\[::1\])(?::(\d{{1,5}}))?", re.ASCII | re.IGNORECASE
)
"""Names of this machine, which nobody else can own, and a port."""

_PORTS = {"http": 80, "https": 443}
"""That an address leaves out."""

_REFUSED, _TOO_MANY, _SLOW, _FOREIGN = 4403, 4429, 4408, 4400
_WAITING = 500
_GRACE = 5.0
"""For how long the controls are kept for a page that was lost, before another has them [s]."""
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class _OwnNames:
    """Refuses requests for other names than this machine's own.

    Or a site whose name leads here (DNS rebinding) could read the page.
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


def is_own(headers: Headers) -> bool:
    """Whether a request comes from this server's page, or from no page at all.

    A browser tells the origin of the page that asks. It must have the host and the port that the
    request names, which differ from the server's where a tunnel leads to it.

    Args:
        headers: of a request for a name of this machine.
    """
    origins = headers.getlist("origin")
    if not origins:
        return True
    scheme, _, name = origins[0].lower().partition("://")
    if len(origins) > 1 or scheme not in _PORTS:
        return False
    place = _place(name, scheme)
    return place is not None and place == _place(headers["host"], scheme)


def _place(host: str, scheme: str) -> tuple[str, int] | None:
    """Name and port of this machine; None of another."""
    found = _HOST.fullmatch(host)
    return found and (found[1].lower(), int(found[2] or _PORTS[scheme]))


class Outbox:
    """What waits to be sent to one page: of frames the newest alone, of all else everything."""

    def __init__(self) -> None:
        """Nothing waits yet."""
        self._others: list[Message] = []
        self._frame: Message | None = None
        self._filled = asyncio.Event()
        self.slow = False

    def put(self, message: Message) -> None:
        """Adds a message; does not wait."""
        if message["type"] == "frame":
            self._frame = message
        elif message["type"] == "status" and self._others and self._others[-1]["type"] == "status":
            self._others[-1] = message
        elif not self.slow:
            self._others.append(message)
            self.slow = len(self._others) > _WAITING
        self._filled.set()

    async def take(self) -> list[Message]:
        """All that waits, once there is something."""
        await self._filled.wait()
        self._filled.clear()
        messages, self._others = self._others, []
        if self._frame is not None:
            messages.append(self._frame)
            self._frame = None
        return messages


class Rate:
    """Counts messages: so many a second, and as many at once."""

    def __init__(self, most: float):
        """Begins with all that is allowed at once."""
        self._most = self._left = most
        self._then = time.monotonic()

    def allows(self) -> bool:
        """Whether one more may come now."""
        now = time.monotonic()
        self._left = min(self._left + (now - self._then) * self._most, self._most)
        self._then = now
        allowed = self._left >= 1
        self._left -= allowed
        return allowed


class _Visitor:
    """An open page."""

    def __init__(self, page: WebSocket, controls: bool):
        self.page, self.controls, self.outbox = page, controls, Outbox()

    def hear(self, message: Message) -> None:
        """Takes what the conductor tells."""
        if message["type"] == "hello":
            message = {**message, "role": "controller" if self.controls else "watcher"}
        self.outbox.put(message)

    def complain(self, text: str) -> None:
        self.outbox.put({"type": "error", "message": text})


class Live:
    """The server of one session."""

    def __init__(self, conductor: Conductor, token: str):
        """Keeps what it serves.

        Args:
            conductor: of the session.
            token: that the address must carry.
        """
        self._conductor, self._token = conductor, token
        self._doorway = Doorway()
        self._visitors: list[_Visitor] = []
        self._grace: asyncio.TimerHandle | None = None

    def server(self) -> uvicorn.Server:
        """What `serve` takes; to end it, set its `should_exit`."""
        return make_server(
            self._app(),
            self._doorway,
            ws="websockets-sansio",  # the default of older releases is deprecated
            ws_max_size=LONGEST_MESSAGE,
            timeout_graceful_shutdown=1,
        )

    async def serve(self, server: uvicorn.Server, listening: socket.socket) -> None:
        """Serves the page and plays the session until the server is told to end.

        Raises:
            ResultsError: if the journal cannot be written: nothing is played that is not noted.
            WalkerError: if the learner diverged.
        """
        # Pages inherit it; or a frame waits up to 40 ms for word that what went before has arrived.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        playing = asyncio.create_task(self._conductor.run())
        playing.add_done_callback(lambda _: setattr(server, "should_exit", True))
        await server.serve(sockets=[listening])
        playing.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await playing

    def _app(self) -> Starlette:
        files = [Route(f"/{path.name}", self._file) for path in _PAGE.iterdir() if path.is_file()]
        return Starlette(
            routes=[
                Route("/", self._page),
                *files,
                Route("/favicon.ico", _nothing),
                WebSocketRoute("/socket", self._visit),
            ],
            middleware=[Middleware(_OwnNames)],
        )

    def _knows(self, token: str | None) -> bool:
        return secrets.compare_digest((token or "").encode(), self._token.encode())

    async def _page(self, request: Request) -> Response:
        if not self._knows(request.query_params.get("token")):
            said = "This page needs the whole address that `hitl-jax live` printed, with its token."
            return PlainTextResponse(said, 403, headers=_HEADERS)
        return FileResponse(_PAGE / "index.html", headers=_HEADERS)

    async def _file(self, request: Request) -> Response:
        return FileResponse(_PAGE / request.url.path.lstrip("/"), headers=_HEADERS)

    async def _visit(self, page: WebSocket) -> None:
        """A page's socket, from when it comes to when it goes."""
        await page.accept()
        if not is_own(page.headers):
            await page.close(_FOREIGN, "another site's page may not speak to this session")
            return
        if not self._knows(page.query_params.get("token")):
            await page.close(_REFUSED, "the address needs the token that `hitl-jax live` printed")
            return
        if page.client is not None:
            self._doorway.admit((page.client.host, page.client.port))
        visitor = _Visitor(page, controls=not any(other.controls for other in self._visitors))
        self._visitors.append(visitor)
        self._conductor.listen(visitor.hear)
        if visitor.controls:
            if self._grace is not None:
                self._grace.cancel()
            self._conductor.come()
        sending = asyncio.create_task(_send(visitor))
        try:
            await self._hear(visitor)
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            sending.cancel()
            self._visitors.remove(visitor)
            self._conductor.forget(visitor.hear)
            if visitor.controls:
                self._conductor.leave()
                loop = asyncio.get_running_loop()
                self._grace = loop.call_later(_GRACE, self._pass_on)

    def _pass_on(self) -> None:
        """Gives the controls to who has watched longest, if nobody came back for them."""
        if self._visitors and not any(visitor.controls for visitor in self._visitors):
            heir = self._visitors[0]
            heir.controls = True
            heir.outbox.put({"type": "role", "role": "controller"})
            self._conductor.come()

    async def _hear(self, visitor: _Visitor) -> None:
        """Does what a page says until it goes or is sent away."""
        rate, wrong = Rate(MOST_MESSAGES), Rate(_PATIENCE)
        while True:
            message = await visitor.page.receive()
            if message["type"] == "websocket.disconnect":
                return
            if not rate.allows():
                reason = f"more than {MOST_MESSAGES} messages a second"
                await visitor.page.close(_TOO_MANY, reason)
                return
            try:
                command = commands.parse(message.get("text") or "")
                if visitor.controls:
                    self._conductor.say(command)
                elif command["type"] != "seen":  # Whether those who only watch do is not asked.
                    raise ValueError("somebody else controls this session; you can watch")
            except ValueError as error:
                visitor.complain(str(error))
                if not wrong.allows():
                    reason = f"more than {_PATIENCE} messages a second that mean nothing"
                    await visitor.page.close(_FOREIGN, reason)
                    return


async def _nothing(_: Request) -> Response:
    return Response(status_code=204)


async def _send(visitor: _Visitor) -> None:
    """Sends what waits; one who is too slow is sent away, and holds nobody up."""
    page, outbox = visitor.page, visitor.outbox
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while page.application_state is WebSocketState.CONNECTED:
            for message in await outbox.take():
                await page.send_text(json.dumps(message, separators=(",", ":")))
            if outbox.slow:
                await page.close(_SLOW, "this page is too slow for the session")
