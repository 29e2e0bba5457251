"""A page that stops answering pauses the session; one that is slow or busy does not."""

import asyncio
import json
import time

import pytest
from live_team import HYPER, Served, setup_of
from simulated_page import FRAME, LIMIT, SimulatedPage

from hitl_jax.evaluation.trials import frozen
from hitl_jax.live.session import Session


def test_silence_in_a_pause_means_nothing(live):
    """No frame was shown that could have been answered."""

    async def happens(one):
        one.page.say("danger", one.number, down=True)
        one.page.say("take", one.number)
        one.page.say("pause", on=True)
        await asyncio.sleep(0.5)
        one.page.dead = True
        await asyncio.sleep(40)
        assert one.session.person.in_control
        one.page.dead = False
        held = one.number
        one.page.say("pause", on=False)
        await asyncio.sleep(2)
        assert one.number > held + 90
        assert one.session.person.in_control

    one = live(happens)
    assert one.said("gone") == []
    assert one.page.last("status")["why_paused"] is None


def test_what_was_shown_before_a_pause_is_to_be_answered(live):
    async def happens(one):
        one.page.say("take", one.number)
        one.page.late = 0.1
        await asyncio.sleep(0.2)
        one.page.say("pause", on=True)
        one.page.dead = True
        await asyncio.sleep(40)
        assert not one.session.person.in_control

    one = live(happens)
    assert len(one.said("gone")) == 1


@pytest.mark.parametrize("silence", [0.1, 0.5, 0.9])
def test_a_shorter_silence_means_nothing(live, silence):
    async def happens(one):
        one.page.say("take", one.number)
        for _ in range(4):
            one.page.dead = True
            await asyncio.sleep(silence)
            one.page.dead = False
            await asyncio.sleep(0.1)
        assert one.session.person.in_control

    assert live(happens).said("gone") == []


@pytest.mark.parametrize("late", [0.0, 0.3, 0.8, 3.0])
def test_answers_that_come_late_but_come_are_answers(live, late):
    """Over a slow line; the session begins with the first answer."""

    async def happens(one):
        one.go()
        one.come(SimulatedPage(one.paced, late))
        before = one.number
        await asyncio.sleep(late + 5)
        assert one.number - before > 200 if late < LIMIT else one.number - before < 100

    one = live(happens)
    # Answers of which the first after a start takes longer than the limit come too late.
    assert len(one.said("gone")) == 1 + (late > LIMIT)


def test_a_program_that_is_busy_hears_no_silence(live, monkeypatch):
    """As where it compiles for some seconds, and where the machine is too slow for each step."""

    async def happens(one):
        tick = one.session.tick

        def busy(seconds):
            def slow():
                one.selector.now += seconds
                return tick()

            return slow

        one.page.say("take", one.number)
        for seconds in (5.0, 30.0):
            monkeypatch.setattr(one.session, "tick", busy(seconds))
            await asyncio.sleep(0.01)
            monkeypatch.setattr(one.session, "tick", tick)
            await asyncio.sleep(0.2)
        monkeypatch.setattr(one.session, "tick", busy(0.5))
        await asyncio.sleep(20)
        assert one.session.person.in_control
        # Nor does it take silence for an answer.
        one.page.dead = True
        before = one.number
        await asyncio.sleep(30)
        assert not one.session.person.in_control
        assert 0 < one.number - before < 50

    assert len(live(happens).said("gone")) == 1


@pytest.mark.parametrize("factor", [0.125, 1.0, 8.0, None])
def test_a_second_of_silence_is_one_at_any_speed(live, factor, monkeypatch):
    async def happens(one):
        tick = one.session.tick

        def quick():
            one.selector.now += 0.004
            return tick()

        monkeypatch.setattr(one.session, "tick", quick)
        one.page.say("speed", factor=factor)
        await asyncio.sleep(1)
        one.page.dead = True
        began = one.selector.now
        while not one.page.last("status")["why_paused"]:
            await asyncio.sleep(0.01)
        slack = 0.2 + FRAME / (factor or 1)  # Until the first frame that is not answered.
        assert LIMIT - 0.1 <= one.selector.now - began <= LIMIT + slack

    live(happens)


def test_a_line_that_stalls_and_comes_back(live):
    """Answers that were under way come all at once; the person sees why it stopped, and goes on."""

    async def happens(one):
        seen = one.number
        one.page.say("danger", seen, down=True)
        await asyncio.sleep(0.2)
        one.page.dead = True
        await asyncio.sleep(3)
        one.page.dead = False
        stopped = one.number
        for number in range(seen, stopped + 1):
            one.page.say("seen", number)
        one.page.say("danger", stopped, down=False)
        await asyncio.sleep(3)
        assert one.number == stopped  # It does not go on by itself.
        assert "did not answer" in one.page.last("status")["why_paused"]
        one.page.say("pause", on=True)
        assert one.page.last("status")["why_paused"]
        one.page.say("step")
        await asyncio.sleep(0.2)
        assert one.number == stopped + 1
        one.page.say("pause", on=False)
        await asyncio.sleep(2)
        assert one.number > stopped + 90
        status = one.page.last("status")
        assert not status["paused"]
        assert status["why_paused"] is None
        # And again.
        one.page.dead = True
        await asyncio.sleep(3)
        assert one.page.last("status")["why_paused"]

    one = live(happens)
    assert len(one.said("gone")) == 2


def test_a_page_that_opens_again_after_its_silence_sees_why_it_stopped(live):
    async def happens(one):
        one.page.say("take", one.number)
        await asyncio.sleep(0.5)
        one.page.dead = True
        await asyncio.sleep(40)
        one.go()
        stopped = one.number
        await asyncio.sleep(40)
        one.come(SimulatedPage(one.paced))
        await asyncio.sleep(2)
        assert one.number == stopped
        status = one.page.last("status")
        assert status["paused"]
        assert "did not answer" in status["why_paused"]
        one.page.say("pause", on=False)
        await asyncio.sleep(1)
        assert one.number > stopped + 40

    one = live(happens)
    first, second = one.said("gone")
    kinds = [label.kind for label in one.session.labels]
    assert kinds == ["take", "nobody"]
    assert second["frame"] > first["frame"]


def test_a_page_that_is_closed_in_its_silence_is_gone_since_its_last_answer(live):
    async def happens(one):
        one.page.say("take", one.number)
        await asyncio.sleep(0.5)
        one.page.dead = True
        await asyncio.sleep(0.5)
        one.go()
        await asyncio.sleep(1)

    one = live(happens)
    take, nobody = one.session.labels
    assert take.last == one.said("gone")[0]["frame"]
    assert (nobody.kind, nobody.first, nobody.last) == ("nobody", take.last + 1, one.number - 1)
    assert nobody.last - nobody.first == pytest.approx(25, abs=4)


def test_nothing_is_played_before_the_page_has_shown_a_frame(live):
    async def happens(one):
        one.go()
        before = one.number
        late = SimulatedPage(one.paced)
        late.dead = True
        one.come(late)
        await asyncio.sleep(40)
        assert one.number == before
        assert one.page.last("status")["paused"]
        assert one.page.last("status")["why_paused"] is None
        late.dead = False
        late.say("seen", before)
        await asyncio.sleep(1)
        assert one.number > before + 40

    live(happens)


def test_those_who_watch_are_not_asked_whether_they_are_there(live):
    async def happens(one):
        other = SimulatedPage(one.paced)
        other.dead = True
        one.paced.add_listener(other.hear)
        before = one.number
        await asyncio.sleep(5)
        assert one.number > before + 200
        # Nor is one of them heard in the other's place: the server hands no answer of theirs on.
        one.page.dead = True
        await asyncio.sleep(3)
        assert "did not answer" in other.last("status")["why_paused"]

    live(happens)


def test_a_simulated_human_needs_nobody(live):
    async def happens(one):
        one.page.dead = True
        before = one.number
        await asyncio.sleep(5)
        assert one.number > before + 200
        one.go()
        one.come(one.page)
        await asyncio.sleep(5)
        assert one.number > before + 400

    one = live(happens, setup_of(with_person=False, learns=False), mode="watch")
    assert [line for line in one.lines if "said" in line] == []


def test_who_is_silent_where_the_walker_asks_is_gone_after_that_frame(live):
    async def happens(one):
        while not one.page.last("status")["asking"]:
            await asyncio.sleep(0.02)
        one.asked = one.number
        await asyncio.sleep(0.1)
        one.page.dead = True
        await asyncio.sleep(4)
        assert one.number == one.asked  # It still waits: no other frame was shown.
        await asyncio.sleep(40)

    setup = setup_of(hyper=frozen(HYPER, human_present=True), learns=False)
    one = live(happens, setup, asks=True, mode="test")
    [no_answer] = one.said("no_answer")
    [gone] = one.said("gone")
    assert no_answer["frame"] == gone["frame"] == one.asked
    assert one.number > one.asked


def test_a_page_that_stands_still_and_comes_back(tmp_path):
    """With a real socket: it reads and answers nothing for a second."""

    def until(page, true):
        end = time.monotonic() + 30
        while time.monotonic() < end:
            message = json.loads(page.recv(timeout=30))
            if message["type"] == "frame":
                page.send(json.dumps({"type": "seen", "frame": message["n"]}))
            if true(message):
                return message
        raise TimeoutError

    path = tmp_path / "journal.jsonl"
    with (
        Served(Session(setup_of(learns=False)), path, silence_seconds=0.5) as served,
        served.open() as page,
    ):
        seen = until(page, lambda m: m["type"] == "frame" and m["n"] > 10)["n"]
        page.send(json.dumps({"type": "danger", "down": True, "frame": seen}))
        page.send(json.dumps({"type": "take", "frame": seen}))
        until(page, lambda m: m["type"] == "frame" and m["control"] == "person")
        with served.open() as other:
            end = time.monotonic() + 30
            while not any(said["type"] == "gone" for said in served.said()):
                assert time.monotonic() < end
                for message in map(json.loads, (other.recv(timeout=30) for _ in range(3))):
                    if message["type"] == "frame":  # Who watches answers for nobody else.
                        other.send(json.dumps({"type": "seen", "frame": message["n"]}))
        assert not served.session.person.in_control
        stopped = served.session.frame.number
        why = until(page, lambda m: m["type"] == "status" and m["why_paused"])
        assert why["paused"]
        assert f"to {stopped - 1}." in why["why_paused"]
        page.send(json.dumps({"type": "seen", "frame": 10**6}))
        refused = until(page, lambda m: m["type"] == "error")["message"]
        assert refused == f"seen: frame 1000000: must be from 0 to {stopped}"
        page.send(json.dumps({"type": "pause", "on": False}))
        until(page, lambda m: m["type"] == "frame" and m["n"] > stopped + 20)
