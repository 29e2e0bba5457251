"""Frames that nobody was there to judge: what was held ends, and control of them costs nothing."""

import asyncio

import numpy as np
import pytest
from live_team import play, setup_of, stored
from simulated_page import SILENT_FRAMES

from hitl_jax.commands import recorded
from hitl_jax.live import journal, messages
from hitl_jax.live.labels import Label, judged, unjudged
from hitl_jax.live.recorded_person import steps_of
from hitl_jax.live.session import Session


def test_danger_and_control_that_are_held_by_nobody_end(live):
    async def happens(one):
        one.page.say("danger", one.number, down=True)
        one.page.say("take", one.number)
        one.page.say("hands", action=[1, 0, 0, 0])
        await asyncio.sleep(0.5)
        assert one.session.person.in_control
        one.page.dead = True
        one.seen = one.number - 1
        await asyncio.sleep(40)
        assert not one.session.person.in_control
        assert not one.session.person.dangerous
        one.stop = one.number
        assert one.stop - one.seen == SILENT_FRAMES
        await asyncio.sleep(400)

    one = live(happens, setup_of())
    session, layout = one.session, one.session.setup.agent.layout
    assert one.number == one.stop  # Nothing more is played.
    [gone] = one.said("gone")
    assert gone["frame"] == pytest.approx(one.seen, abs=2)
    first = gone["frame"] + 1
    assert np.flatnonzero(unjudged(session.labels, 0, one.stop)).tolist() == [
        *range(first, one.stop)
    ]
    assert not judged(session.labels, first, one.stop).any()
    assert judged(session.labels, first - 10, first).all()
    # It was played as it was, but it is no intervention that is punished, and moves no boundary.
    frames = session.frames(first, one.stop)
    assert (frames[:, layout.action] == [1, 0, 0, 0]).all()
    assert (frames[:, layout.reward] > -19).any()
    assert (session.frames(first - 10, first)[:, layout.reward] < -19).all()
    assert (frames[:, layout.boundary] == frames[:, layout.next_boundary]).all()
    assert (frames[:, layout.boundary_reward] == 0).all()
    stored(session)
    status, frame = one.page.last("status"), one.page.last("frame")
    assert status["paused"]
    assert status["labels"] == 2
    assert "did not answer for 1 s" in status["why_paused"]
    assert f"Nobody judged frames {first} to {one.stop - 1}." in status["why_paused"]
    assert (frame["danger"], frame["control"], frame["n"]) == (False, "machine", one.stop)


def test_a_page_that_holds_nothing_and_answers_no_more_stops_the_session_too(live):
    async def happens(one):
        before = one.number
        one.page.dead = True
        await asyncio.sleep(40)
        assert one.number - before == SILENT_FRAMES

    one = live(happens)
    [label] = one.session.labels
    assert (label.kind, label.last) == ("nobody", one.number - 1)
    assert one.page.last("status")["labels"] == 0


@pytest.mark.parametrize("intervention", ["penalty", "reset"])
def test_an_intervention_that_nobody_made_costs_nothing(live, intervention):
    async def happens(one):
        one.page.say("danger", one.number, down=True)
        one.page.dead = True
        await asyncio.sleep(40)

    one = live(happens, setup_of(intervention, learns=False))
    session, layout = one.session, one.session.setup.agent.layout
    [gone] = one.said("gone")
    nobodys = range(gone["frame"] + 1, one.number)
    assert any(session.flag("control", n) for n in nobodys)
    frames = session.frames(nobodys.start, nobodys.stop)
    fell = frames[:, layout.terminated] > 0
    assert (frames[~fell, layout.reward] > -19).all()
    reset = [session.flag("human_reset", n) for n in nobodys]
    assert any(reset) == (intervention == "reset")
    assert (frames[reset][:, [layout.terminated, layout.truncated]] == [0, 1]).all()


def test_a_judgement_of_frames_that_were_nobodys_counts():
    session = Session(setup_of("penalty", learns=False))
    play(session, 40)
    session.person.gone(9)
    assert session.labels == [Label(0, "nobody", 10, 39)]
    start = session.frames(10, 11)[0, session.setup.agent.layout.boundary]
    assert session.frame.boundary == start
    alarmed = next(n for n in range(12, 40) if session.flag("alarmed", n))
    session.person.danger(True, alarmed)
    session.person.danger(False, alarmed)
    session.person.let_go(40)
    assert session.frame.boundary == pytest.approx(start - 0.01, abs=1e-6)
    assert np.flatnonzero(~unjudged(session.labels, 10, 40)).tolist() == [alarmed - 10]
    # To take a label back takes back the person's, not that nobody was there.
    assert session.person.undo().kind == "danger"
    assert session.person.undo() is None
    assert session.labels == [Label(0, "nobody", 10, 39)]
    assert session.frame.boundary == start


def test_where_no_person_is_none_can_go():
    session = Session(setup_of(with_person=False, learns=False))
    with pytest.raises(ValueError, match="nobody is asked in this session"):
        session.person.gone(0)


@pytest.mark.parametrize(("seen", "first"), [(-1, 0), (0, 1), (9, None), (10, None), (99, None)])
def test_where_all_was_seen_nothing_is_nobodys(seen, first):
    session = Session(setup_of(learns=False))
    play(session, 10)
    session.person.take(5)
    session.person.gone(seen)
    assert not session.person.dangerous
    assert not session.person.in_control
    kinds = ["take"] if first is None else ["take", "nobody"]
    assert [label.kind for label in session.labels] == kinds
    assert session.labels[0].last == min(seen, 9)


def test_a_silence_longer_than_the_replay_is_nobodys_whole():
    session = Session(setup_of(learns=False))
    play(session, 20)
    session.person.danger(True, 20)
    play(session, 1000)
    session.person.gone(30)
    assert np.flatnonzero(judged(session.labels, 0, 1000)).tolist() == [*range(20, 31)]
    assert unjudged(session.labels, 0, 1000).sum() == 1000 - 31


def test_no_page_can_say_that_somebody_is_gone():
    with pytest.raises(ValueError, match="its type must be one of"):
        messages.parse('{"type": "gone", "frame": 3}')


def _recorded(tmp_path, until, gone):
    """What `hitl-jax recorded` reads where somebody judged frames 10 to 29 and was gone after."""
    path = tmp_path / "journal.jsonl"
    session, noted = Session(setup_of("penalty", learns=False)), journal.Journal(path)
    noted.begin({})
    said = {
        10: {"type": "danger", "down": True, "frame": 10},
        until: {"type": "gone", "frame": gone},
    }
    for number in range(65):
        if number in said:
            noted.said(session, said[number])
        if number < 64:
            session.tick()
            noted.played(session)
    noted.close()
    return steps_of(Session(setup_of("penalty", learns=False)), journal.read(path)[1], path)


def test_a_recorded_human_has_no_judgements_of_nobody(tmp_path):
    steps = _recorded(tmp_path, until=50, gone=29)
    assert steps.unjudged == 20
    assert len(steps.dangerous) == len(steps.observation) == len(steps.alarmed) == 44
    assert np.flatnonzero(steps.dangerous).tolist() == [*range(10, 30)]
    assert np.flatnonzero(steps.begins).tolist() == [0, 30]  # A delay does not reach across.
    assert steps.episodes == 1
    said = "\n".join(recorded.report_of(steps))
    assert "44 steps of 1 episodes; judged dangerous: 20 steps" in said
    assert "steps that nobody was there to judge, left out: 20" in said


def test_a_session_that_nobody_saw_has_no_judgements(tmp_path):
    steps = _recorded(tmp_path, until=64, gone=-1)
    assert steps.unjudged == 64
    assert [len(column) for column in steps[:4]] == [0] * 4
