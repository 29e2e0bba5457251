"""The server of the live page, by a real socket: who may come, and what a person does there."""

import asyncio
import contextlib
import errno
import json
import socket
import time

import pytest
from live_team import TOKEN, Served, setup_of
from starlette.datastructures import Headers
from websockets.exceptions import ConnectionClosed

from hitl_jax.errors import ResultsError
from hitl_jax.live import journal, server
from hitl_jax.live.pacing import PacedSession
from hitl_jax.live.page_updates import PageOptions
from hitl_jax.live.server import MAX_MESSAGE_BYTES, Outbox, PageServer, RateLimit
from hitl_jax.live.session import Session


def _until(page, kind, true=lambda message: True, seconds=20):
    """The first message of a kind for which something is true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        message = json.loads(page.recv(timeout=seconds))
        if message["type"] == "frame":
            _say(page, "seen", frame=message["n"])
        if message["type"] == kind and true(message):
            return message
    raise TimeoutError(kind)


def _say(page, kind, **fields):
    page.send(json.dumps({"type": kind, **fields}))


@pytest.fixture
def served(tmp_path):
    with Served(Session(setup_of()), tmp_path / "journal.jsonl") as one:
        yield one


@pytest.fixture(scope="module")
def one_for_all(tmp_path_factory):
    """One whose session nobody comes to."""
    folder = tmp_path_factory.mktemp("served")
    with Served(Session(setup_of()), folder / "journal.jsonl") as one:
        yield one


def _refusal(page):
    """Why a page was sent away: code and reason."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            page.recv(timeout=20)
    return page.close_code, page.close_reason


def test_only_those_who_know_the_address_come_in(served):
    assert served.page("/")[0] == 403
    assert served.page("/?token=wrong")[0] == 403
    status, text = served.page(f"/?token={TOKEN}")
    assert status == 200
    assert "<canvas" in text
    assert served.page(f"/?token={TOKEN}", Host="evil.example")[0] == 400
    assert served.page("/../server.py")[0] == 404
    with served.open(token="wrong") as page:
        assert _refusal(page) == (4403, "the address needs the token that `hitl-jax live` printed")
    with served.open(origin="http://evil.example") as page:
        assert _refusal(page) == (4400, "another site's page may not speak to this session")
    with served.open(origin=None, token="wrong") as page:
        assert _refusal(page)[0] == 4403
    assert served.session.frame.number == 0  # Nobody came: nothing was played.


@pytest.mark.parametrize(
    "host", ["127.0.0.1:9000", "localhost:9000", "LOCALHOST:9000", "[::1]:9000", "127.0.0.2:80"]
)
def test_the_page_works_behind_a_tunnel_from_another_port(served, host):
    """As after `ssh -L 9000:127.0.0.1:8765`: the page and its socket are asked for at port 9000."""
    assert served.page(f"/?token={TOKEN}", Host=host)[0] == 200
    assert served.page("/live.js", Host=host)[0] == 200
    assert served.page("/", Host=host)[0] == 403
    with served.open(host=host) as page:
        assert _until(page, "hello")["role"] == "controller"
    with served.open(host=host, token="wrong") as page:
        assert _refusal(page)[0] == 4403
    with served.open(host=host, origin="http://evil.example") as page:
        assert _refusal(page) == (4400, "another site's page may not speak to this session")


@pytest.mark.parametrize(
    ("host", "origin", "own"),
    [
        ("localhost:8765", "http://localhost:8765", True),
        ("localhost:8765", "http://LocalHost:8765", True),
        ("LOCALHOST:8765", "http://localhost:8765", True),
        ("[::1]:9000", "http://[::1]:9000", True),
        ("127.1.2.255:9000", "http://127.1.2.255:9000", True),
        # A port that is left out is the scheme's.
        ("localhost", "http://localhost", True),
        ("localhost:80", "http://localhost", True),
        ("localhost", "http://localhost:80", True),
        ("localhost", "https://localhost", True),
        ("localhost:443", "https://localhost", True),
        ("localhost:80", "https://localhost", False),
        ("localhost:443", "http://localhost", False),
        # A proxy that adds TLS.
        ("localhost:9000", "https://localhost:9000", True),
        # Another page of this machine.
        ("localhost:8765", "http://localhost:8766", False),
        ("localhost:8765", "http://localhost", False),
        ("localhost:8765", "http://127.0.0.1:8765", False),
        ("127.0.0.1:8765", "http://localhost:8765", False),
        ("127.0.0.1:8765", "http://127.0.0.2:8765", False),
        ("127.0.0.1:8765", "http://[::1]:8765", False),
        ("[::1]:8765", "http://::1:8765", False),
        # No page of ours.
        ("localhost:8765", "null", False),
        ("localhost:8765", "", False),
        ("localhost:8765", "http://", False),
        ("localhost:8765", "localhost:8765", False),
        ("localhost:8765", "ws://localhost:8765", False),
        ("localhost:8765", "file://localhost:8765", False),
        ("localhost:8765", "http://localhost:8765/", False),
        ("localhost:8765", "http://me@localhost:8765", False),
        ("localhost:8765", "http://localhost:8765.evil.example", False),
        ("localhost:8765", "http://evil.example:8765", False),
        ("localhost:8765", "http://localhost:8765 http://localhost:8765", False),
    ],
)
def test_only_a_page_of_the_host_that_is_asked_may_speak(host, origin, own):
    assert server.is_same_origin(Headers({"host": host, "origin": origin})) == own


def test_who_is_no_page_may_speak_and_who_says_two_things_may_not():
    host = (b"host", b"localhost:8765")
    origin = (b"origin", b"http://localhost:8765")
    assert server.is_same_origin(Headers(raw=[host]))
    assert server.is_same_origin(Headers(raw=[host, origin]))
    assert not server.is_same_origin(Headers(raw=[host, origin, origin]))


_UPGRADE = (
    "Connection: Upgrade",
    "Upgrade: websocket",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)


@pytest.mark.parametrize("path", ["/", "/live.js", "/socket"])
@pytest.mark.parametrize(
    "hosts",
    [
        ["evil.example"],  # Such a name can lead here: DNS rebinding.
        ["evil.example:8765"],
        ["localhost.evil.example:8765"],
        ["127.0.0.1.evil.example"],
        ["127.0.0.256:8765"],
        ["0.0.0.0:8765"],
        ["10.0.0.1:8765"],
        ["localhost:port"],
        ["localhost:"],
        ["[::2]:8765"],
        ["::1"],
        ["me@localhost:8765"],
        ["local host"],
        ["löcalhost"],
        [""],
        ["localhost:8765", "evil.example"],
        ["localhost:8765", "localhost:8765"],
        [],
    ],
)
def test_requests_for_other_names_are_refused_in_one_line(one_for_all, hosts, path):
    lines = [f"GET {path}?token={TOKEN} HTTP/1.1", *(f"Host: {host}" for host in hosts)]
    if path == "/socket":
        origins = (f"Origin: http://{host}" for host in hosts[:1])
        lines += [*_UPGRADE, *origins]
    status, said = one_for_all.answer(*lines)
    assert status == 400
    assert "Host must be localhost" in said or "Invalid HTTP request" in said
    assert one_for_all.session.frame.number == 0


def test_a_person_judges_takes_over_and_takes_back(served):
    with served.open() as page:
        hello = _until(page, "hello")
        assert (hello["role"], hello["intervention"]) == ("controller", "takeover")
        assert len(hello["shapes"]) == 5
        assert len(_until(page, "terrain")["x"]) == 200
        frame = _until(page, "frame", lambda m: m["n"] > 20)
        assert len(frame["bodies"]) == 5
        assert len(frame["lidar"]) == 10
        _say(page, "take", frame=frame["n"])
        _say(page, "hands", action=[1, 0, 0, 0])
        taken = _until(page, "frame", lambda m: m["control"] == "person")
        assert taken["danger"]
        _say(page, "let_go", frame=taken["n"])
        _until(page, "frame", lambda m: m["control"] == "machine")
        assert _until(page, "status")["labels"] == 1
        _say(page, "undo")
        _until(page, "status", lambda m: m["labels"] == 0)
        _say(page, "danger", down=True, frame=10**9)
        assert "frame 1000000000: must be from" in _until(page, "error")["message"]
    kinds = [said["type"] for said in served.said()]
    assert kinds[:4] == ["take", "hands", "let_go", "undo"]


def test_a_label_that_comes_300_ms_late_goes_to_the_frame_that_was_seen(served):
    with served.open() as page:
        seen = _until(page, "frame", lambda m: m["n"] > 10)["n"]
        time.sleep(0.3)
        held = served.session.frame.number
        _say(page, "danger", down=True, frame=seen)
        _say(page, "danger", down=False, frame=seen)
        _until(page, "status", lambda m: m["labels"] >= 1)
        assert served.session.labels[0].first == seen
        [came, *_] = [line["at"] for line in journal.read(served.path)[1] if "said" in line]
        assert came >= held > seen


def test_pause_step_and_speed(served):
    with served.open() as page:
        _until(page, "frame", lambda m: m["n"] > 5)
        _say(page, "pause", on=True)
        _until(page, "status", lambda m: m["paused"])
        time.sleep(0.1)
        held = served.session.frame.number
        time.sleep(0.2)
        assert served.session.frame.number == held
        _say(page, "step")
        assert _until(page, "frame", lambda m: m["n"] > held)["n"] == held + 1
        _say(page, "speed", factor=None)
        _say(page, "pause", on=False)
        quick = _until(page, "status", lambda m: m["speed"] is None and m["rate"] > 60)
        assert not quick["paused"]


def _at_rest(session):
    """The frame at which the session stops, soon."""
    deadline = time.monotonic() + 10.0
    before = None
    while (now := session.frame.number) != before:
        assert time.monotonic() < deadline, "it does not stop"
        before = now
        time.sleep(0.3)
    return now


def test_one_controls_and_others_watch(served):
    with served.open() as first, served.open() as second:
        assert _until(second, "hello")["role"] == "watcher"
        _until(first, "frame")  # It begins once the page that controls has answered.
        _until(second, "frame", lambda m: m["n"] > 3)
        _say(second, "pause", on=True)
        assert "somebody else controls" in _until(second, "error")["message"]
        assert served.said() == []
        _until(first, "status", lambda m: m["watchers"] == 1 and not m["paused"])
    # Who left and comes again has the controls again, and it goes on.
    held = _at_rest(served.session)
    with served.open() as page:
        hello = _until(page, "hello")
        assert hello["role"] == "controller"
        _until(page, "frame", lambda m: m["n"] > held + 10)


def test_who_watches_has_the_controls_after_a_while(served, monkeypatch):
    monkeypatch.setattr(server, "_RECONNECT_SECONDS", 0.1)
    with served.open() as first, served.open() as second:
        assert _until(second, "hello")["role"] == "watcher"
        first.close()
        assert _until(second, "role")["role"] == "controller"
        _say(second, "pause", on=True)
        _until(second, "status", lambda m: m["paused"])


def test_a_lost_page_lets_go_of_the_controls(served):
    with served.open() as page:
        frame = _until(page, "frame", lambda m: m["n"] > 3)
        _say(page, "take", frame=frame["n"])
        _until(page, "frame", lambda m: m["control"] == "person")
    end = time.monotonic() + 10
    while served.session.person.in_control and time.monotonic() < end:
        time.sleep(0.02)
    assert not served.session.person.in_control
    # What was said stands.
    assert [label.kind for label in served.session.labels if label.kind != "nobody"] == ["take"]


def test_nonsense_and_floods_are_bounded_and_harm_nothing(served):
    with served.open() as page:
        _until(page, "frame", lambda m: m["n"] > 3)
        page.send("nonsense")
        assert _until(page, "error")["message"] == "a message: is not JSON"
        page.send("x" * (MAX_MESSAGE_BYTES + 1))
        assert _refusal(page)[0] == 1009
    with served.open() as page, contextlib.suppress(ConnectionClosed):
        for _ in range(2000):
            _say(page, "pause", on=False)
        assert _refusal(page) == (4429, "more than 200 messages a second")
    with served.open() as page:
        page.send(b"bytes")
        assert _until(page, "error")["message"] == "a message: is not JSON"
        for _ in range(60):
            page.send("[]")
        assert _refusal(page) == (4400, "more than 20 messages a second that mean nothing")
    with served.open() as page:
        before = served.session.frame.number
        _until(page, "frame", lambda m: m["n"] > before + 20)
    again = Session(setup_of())
    list(journal.play(again, journal.read(served.path)[1], served.path))
    assert again.labels == served.session.labels
    assert all(label.kind == "nobody" for label in again.labels)


def test_the_walker_asks_and_goes_on(tmp_path):
    with (
        Served(Session(setup_of()), tmp_path / "journal.jsonl", True, answer_seconds=2) as served,
        served.open() as page,
    ):
        asked = _until(page, "status", lambda m: m["asking"])["asking"]
        number = asked["frame"]
        assert served.session.frame.number == number
        assert served.session.frame.alarmed
        _say(page, "danger", down=True, frame=number)
        _say(page, "danger", down=False, frame=number)
        _until(page, "frame", lambda m: m["control"] == "person")
        said, control = served.session.labels
        assert (said.first, control.first, control.cause) == (number, number, said.number)
        assert _until(page, "status", lambda m: not m["asking"])["labels"] == 1
        _say(page, "let_go", frame=number + 1)
        # Nobody answers: after a while it goes on, which is noted, but not as the person's word.
        later = _until(page, "status", lambda m: m["asking"] and m["asking"]["frame"] > number)
        labels = list(served.session.labels)
        _until(page, "frame", lambda m: m["n"] > later["asking"]["frame"])
        assert {"type": "no_answer", "frame": later["asking"]["frame"]} in served.said()
        assert served.session.labels == labels
        assert _until(page, "status")["reaction_ms"] == later["reaction_ms"]


def test_what_cannot_be_noted_is_not_played(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    noted = journal.Journal(tmp_path / "journal.jsonl")
    monkeypatch.setattr(journal.os, "write", full)
    paced = PacedSession(Session(setup_of()), noted, PageOptions("train", "", False, 1.0))
    told = []
    paced.add_listener(told.append)
    paced.connect_person()
    paced.handle({"type": "seen", "frame": 0})
    page = PageServer(paced, TOKEN)
    with (
        socket.create_server(("127.0.0.1", 0)) as listening,
        pytest.raises(ResultsError, match="No space left on device"),
    ):
        asyncio.run(page.serve(page.server(), listening))
    noted.close()
    assert told[-1]["type"] == "error"
    assert "No space left on device" in told[-1]["message"]


def test_what_a_person_says_and_cannot_be_noted_ends_the_session(tmp_path, monkeypatch):
    noted = journal.Journal(tmp_path / "journal.jsonl")
    monkeypatch.setattr(journal.os, "write", lambda *_: 0)
    paced = PacedSession(Session(setup_of()), noted, PageOptions("train", "", False, 1.0))
    paced.handle({"type": "undo"})
    noted.close()
    with pytest.raises(ResultsError, match="No space left on device"):
        asyncio.run(paced.run())


def test_a_slow_page_holds_nobody_up():
    outbox = Outbox()
    for number in range(2000):
        outbox.put({"type": "frame", "n": number})
        outbox.put({"type": "status", "n": number})
    assert not outbox.slow
    for number in range(2000):
        outbox.put({"type": "episode", "n": number})
    assert outbox.slow
    assert len(outbox._others) < 600


def test_messages_are_counted_by_the_second():
    rate = RateLimit(10)
    assert sum(rate.allows() for _ in range(100)) == 10
    time.sleep(0.25)
    assert rate.allows()
