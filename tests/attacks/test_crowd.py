"""Connections without the token at the live page's port: number, time and log are limited."""

import asyncio
import contextlib
import json
import logging
import socket
import threading
import time

import pytest
from live_team import TOKEN, Served, setup_of
from websockets.sync.client import connect

from hitl_jax.benchmarks.crowd import crowd, seconds_of_page
from hitl_jax.live.connection_limits import ConnectionLimits, LogLimit, make_server
from hitl_jax.live.session import Session

_REQUEST = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
_SOCKET = (
    _REQUEST + b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


async def _app(scope, receive, send):
    if scope["type"] == "websocket":  # Is accepted, and then left alone.
        await send({"type": "websocket.accept"})
        await receive()
        await receive()
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"there"})


@contextlib.contextmanager
def _served(limits):
    """The port of a server in a thread."""
    listening = socket.create_server(("127.0.0.1", 0))
    server = make_server(_app, limits, ws="websockets-sansio", timeout_graceful_shutdown=1)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])))
    thread.start()
    try:
        while not server.started:
            time.sleep(0.01)
        yield listening.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join()


def _connected(port):
    return socket.create_connection(("127.0.0.1", port))


def _is_closed(one, seconds=5.0):
    """Whether the other side ends a connection within a while."""
    one.settimeout(seconds)
    try:
        while one.recv(4096):
            pass
    except TimeoutError:
        return False
    except ConnectionError:
        pass
    return True


@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"G",
        _REQUEST,
        _REQUEST + b"Content-Length: 1000000\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nab",
        _SOCKET,
    ],
)
def test_a_stranger_may_stay_for_a_while_only(said):
    with (
        _served(ConnectionLimits(seconds=0.3)) as port,
        _connected(port) as one,
    ):
        one.sendall(said)
        assert _is_closed(one)


def test_a_trickle_of_bytes_buys_no_time():
    with (
        _served(ConnectionLimits(seconds=0.5)) as port,
        _connected(port) as one,
    ):
        began = time.monotonic()
        one.sendall(_REQUEST)
        with contextlib.suppress(ConnectionError):
            while time.monotonic() - began < 5.0:
                one.sendall(b"X-A: b\r\n")
                time.sleep(0.05)
        assert time.monotonic() - began < 4.0


def test_the_one_that_was_idle_longest_goes_for_one_more():
    with _served(ConnectionLimits(most=3, seconds=60.0)) as port, contextlib.ExitStack() as held:
        first, *others = [held.enter_context(_connected(port)) for _ in range(4)]
        assert _is_closed(first)
        for one in others:
            one.sendall(_REQUEST + b"\r\n")
            one.settimeout(5.0)
            answer = b""  # TCP may bring its parts together or one by one.
            while b"there" not in answer and (part := one.recv(4096)):
                answer += part
            assert b"there" in answer


def test_who_has_shown_the_token_stays(tmp_path, monkeypatch):
    """A page that is open keeps its connection, beside a crowd and after the time limit."""
    monkeypatch.setattr(
        "hitl_jax.live.server.ConnectionLimits", lambda: ConnectionLimits(most=5, seconds=0.3)
    )
    with (
        Served(Session(setup_of()), tmp_path / "journal.jsonl") as served,
        served.open() as page,
        crowd(served.port, size=40),
    ):
        began, number = time.monotonic(), 0
        while number < 100:
            message = json.loads(page.recv(timeout=20))
            if message["type"] == "frame":
                number = message["n"]
                page.send(json.dumps({"type": "seen", "frame": number}))
        assert time.monotonic() - began > 0.6  # Twice the time limit.


def test_a_page_is_had_beside_a_crowd(tmp_path):
    """Times and frames a second are the benchmark's matter, since tests share a machine."""
    with (
        Served(Session(setup_of()), tmp_path / "journal.jsonl") as served,
        crowd(served.port, size=600),
    ):
        time.sleep(1.0)
        for _ in range(5):
            assert seconds_of_page(served.address) < 20.0


def test_a_page_behind_a_proxy_stays(tmp_path, monkeypatch):
    """A proxy's header names the client, but the connection is the proxy's."""
    monkeypatch.setattr(
        "hitl_jax.live.server.ConnectionLimits", lambda: ConnectionLimits(seconds=0.3)
    )
    with Served(Session(setup_of()), tmp_path / "journal.jsonl") as served:
        page = connect(
            f"ws://127.0.0.1:{served.port}/socket?token={TOKEN}",
            additional_headers={"X-Forwarded-For": "10.1.2.3", "X-Forwarded-Proto": "https"},
        )
        with page:
            time.sleep(1.0)
            page.send(json.dumps({"type": "pause", "on": True}))
            while json.loads(page.recv(timeout=20)).get("paused") is not True:
                pass


def test_a_page_without_the_token_is_a_stranger(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "hitl_jax.live.server.ConnectionLimits", lambda: ConnectionLimits(seconds=0.3)
    )
    with (
        Served(Session(setup_of()), tmp_path / "journal.jsonl") as served,
        _connected(served.port) as one,
    ):
        one.sendall(_SOCKET.replace(b"/ ", b"/socket?token=wrong ", 1))
        assert _is_closed(one)


def test_the_log_is_bounded():
    logger = logging.getLogger("uvicorn.error")
    records = []
    handler = logging.Handler()
    handler.emit = records.append
    with _served(ConnectionLimits()) as port:
        logger.addHandler(handler)
        for _ in range(60):
            with _connected(port) as one:
                one.sendall(b"\0\0\0 nonsense \r\n\r\n")
                assert _is_closed(one)
        logger.removeHandler(handler)
    assert [one.getMessage() for one in records][-1] == "more of the log is left out"
    assert len(records) <= 20


def test_after_a_while_lines_are_written_again(monkeypatch):
    now = 0.0
    monkeypatch.setattr("hitl_jax.live.connection_limits.time.monotonic", lambda: now)
    limit = LogLimit()
    record = logging.makeLogRecord({"msg": "said"})
    assert sum(limit.filter(record) for _ in range(1000)) == 20
    now = 61.0
    assert sum(limit.filter(record) for _ in range(1000)) == 20
