"""The server of the live page, with a real socket: what a person can do there."""

import asyncio
import errno
import json
import socket
import time

import pytest
from live_team import TOKEN, Served, flood, say, setup_of, until_update, why_closed

from hitl_jax.errors import ResultsError
from hitl_jax.live import journal, server
from hitl_jax.live.pacing import PacedSession
from hitl_jax.live.page_updates import PageOptions
from hitl_jax.live.server import MAX_MESSAGE_BYTES, Outbox, PageServer, RateLimit
from hitl_jax.live.session import Session


def test_a_person_judges_takes_over_and_takes_back(served):
    with served.open() as page:
        hello = until_update(page, "hello")
        assert (hello["role"], hello["intervention"]) == ("controller", "takeover")
        assert len(hello["shapes"]) == 5
        assert len(until_update(page, "terrain")["x"]) == 200
        frame = until_update(page, "frame", lambda m: m["n"] > 20)
        assert len(frame["bodies"]) == 5
        assert len(frame["lidar"]) == 10
        say(page, "take", frame=frame["n"])
        say(page, "hands", action=[1, 0, 0, 0])
        taken = until_update(page, "frame", lambda m: m["control"] == "person")
        assert taken["danger"]
        say(page, "let_go", frame=taken["n"])
        until_update(page, "frame", lambda m: m["control"] == "machine")
        assert until_update(page, "status")["labels"] == 1
        say(page, "undo")
        until_update(page, "status", lambda m: m["labels"] == 0)
        say(page, "danger", down=True, frame=10**9)
        assert "frame 1000000000: must be from" in until_update(page, "error")["message"]
    kinds = [said["type"] for said in served.said()]
    assert kinds[:4] == ["take", "hands", "let_go", "undo"]


def test_a_label_that_comes_300_ms_late_goes_to_the_frame_that_was_seen(served):
    with served.open() as page:
        seen = until_update(page, "frame", lambda m: m["n"] > 10)["n"]
        time.sleep(0.3)
        held = served.session.frame.number
        say(page, "danger", down=True, frame=seen)
        say(page, "danger", down=False, frame=seen)
        until_update(page, "status", lambda m: m["labels"] >= 1)
        assert served.session.labels[0].first == seen
        [came, *_] = [line["at"] for line in journal.read(served.path)[1] if "said" in line]
        assert came >= held > seen


def test_pause_step_and_speed(served):
    with served.open() as page:
        until_update(page, "frame", lambda m: m["n"] > 5)
        say(page, "pause", on=True)
        until_update(page, "status", lambda m: m["paused"])
        time.sleep(0.1)
        held = served.session.frame.number
        time.sleep(0.2)
        assert served.session.frame.number == held
        say(page, "step")
        assert until_update(page, "frame", lambda m: m["n"] > held)["n"] == held + 1
        say(page, "speed", factor=None)
        say(page, "pause", on=False)
        quick = until_update(page, "status", lambda m: m["speed"] is None and m["rate"] > 60)
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
        assert until_update(second, "hello")["role"] == "watcher"
        until_update(first, "frame")  # It begins once the page that controls has answered.
        until_update(second, "frame", lambda m: m["n"] > 3)
        say(second, "pause", on=True)
        assert "somebody else controls" in until_update(second, "error")["message"]
        assert served.said() == []
        until_update(first, "status", lambda m: m["watchers"] == 1 and not m["paused"])
    # Who left and comes again has the controls again, and it goes on.
    held = _at_rest(served.session)
    with served.open() as page:
        hello = until_update(page, "hello")
        assert hello["role"] == "controller"
        until_update(page, "frame", lambda m: m["n"] > held + 10)


def test_who_watches_has_the_controls_after_a_while(served, monkeypatch):
    monkeypatch.setattr(server, "COME_BACK_SECONDS", 0.1)
    with served.open() as first, served.open() as second:
        assert until_update(second, "hello")["role"] == "watcher"
        first.close()
        assert until_update(second, "role")["role"] == "controller"
        say(second, "pause", on=True)
        until_update(second, "status", lambda m: m["paused"])


def test_a_lost_page_lets_go_of_the_controls(served):
    with served.open() as page:
        frame = until_update(page, "frame", lambda m: m["n"] > 3)
        say(page, "take", frame=frame["n"])
        until_update(page, "frame", lambda m: m["control"] == "person")
    end = time.monotonic() + 10
    while served.session.person.in_control and time.monotonic() < end:
        time.sleep(0.02)
    assert not served.session.person.in_control
    # What was said stands.
    assert [label.kind for label in served.session.labels if label.kind != "nobody"] == ["take"]


def test_nonsense_and_floods_are_bounded_and_harm_nothing(served):
    with served.open() as page:
        until_update(page, "frame", lambda m: m["n"] > 3)
        page.send("nonsense")
        assert until_update(page, "error")["message"] == "a message: is not JSON"
        page.send("x" * (MAX_MESSAGE_BYTES + 1))
        assert why_closed(page)[0] == 1009
    with served.open() as page:
        flood(page, json.dumps({"type": "pause", "on": False}))
        assert why_closed(page) == (4429, "more than 200 messages a second")
    with served.open() as page:
        page.send(b"bytes")
        assert until_update(page, "error")["message"] == "a message: is not JSON"
        flood(page, "[]")
        assert why_closed(page) == (4400, "more than 20 messages a second that mean nothing")
    with served.open() as page:
        before = served.session.frame.number
        until_update(page, "frame", lambda m: m["n"] > before + 20)
    again = Session(setup_of())
    list(journal.play(again, journal.read(served.path)[1], served.path))
    assert again.labels == served.session.labels
    assert all(label.kind == "nobody" for label in again.labels)


def test_the_walker_asks_and_goes_on(tmp_path):
    with (
        Served(Session(setup_of()), tmp_path / "journal.jsonl", True, answer_seconds=2) as served,
        served.open() as page,
    ):
        asked = until_update(page, "status", lambda m: m["asking"])["asking"]
        number = asked["frame"]
        assert served.session.frame.number == number
        assert served.session.frame.alarmed
        say(page, "danger", down=True, frame=number)
        say(page, "danger", down=False, frame=number)
        until_update(page, "frame", lambda m: m["control"] == "person")
        said, control = served.session.labels
        assert (said.first, control.first, control.cause) == (number, number, said.number)
        assert until_update(page, "status", lambda m: not m["asking"])["labels"] == 1
        say(page, "let_go", frame=number + 1)
        # Nobody answers: after a while it goes on, which is noted, but not as the person's word.
        later = until_update(
            page, "status", lambda m: m["asking"] and m["asking"]["frame"] > number
        )
        labels = list(served.session.labels)
        until_update(page, "frame", lambda m: m["n"] > later["asking"]["frame"])
        assert {"type": "no_answer", "frame": later["asking"]["frame"]} in served.said()
        assert served.session.labels == labels
        assert until_update(page, "status")["reaction_ms"] == later["reaction_ms"]


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
    page = PageServer(paced, TOKEN, tmp_path / "journal.jsonl")
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
