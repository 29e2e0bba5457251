"""A session that a person watches: late labels, and labels that are taken back."""

import dataclasses

import jax
import numpy as np
import pytest
from live_team import HYPER, play, setup_of, stored

from hitl_jax import boundary
from hitl_jax.envs import WalkerError
from hitl_jax.envs.visible_walker import VisibleWalker
from hitl_jax.live import background_learner, messages, person
from hitl_jax.live.labels import Label, boundary_along, judged
from hitl_jax.live.session import Session
from hitl_jax.results.episode_measures import Episode
from hitl_jax.team.agent import make_agent
from hitl_jax.training.run_spec import episode_seed


@pytest.fixture(scope="module")
def silent():
    """A session in which nobody says anything, and where its first alarms are."""
    session = Session(setup_of())
    play(session, 96)
    return session, [n for n in range(96) if session.flag("alarmed", n)]


def test_a_label_lands_on_the_frame_that_was_seen(silent):
    """300 ms late: fifteen frames at fifty a second."""
    nobody, alarms = silent
    seen, late = alarms[0], 15
    session = Session(setup_of("penalty"))
    play(session, seen + late)
    before = session.frame.boundary
    session.person.danger(True, seen)
    session.person.danger(False, seen)
    assert [n for n in range(seen + late) if session.flag("dangerous", n)] == [seen]
    # A false alarm of Δ⁺ has become a true one of Δ⁻.
    assert session.frame.boundary == pytest.approx(before - 0.02, abs=1e-6)
    layout = session.setup.agent.layout
    play(session, 96)
    rows = stored(session)
    assert rows[seen, layout.boundary_reward] == 1.0
    assert rows[seen, layout.boundary] == stored(nobody)[seen, layout.boundary]
    assert rows[seen + 1, layout.boundary] == rows[seen, layout.next_boundary]
    assert rows[seen, layout.next_boundary] == rows[seen, layout.boundary] - np.float32(0.01)


def test_an_intervention_that_is_taken_back_costs_nothing():
    session = Session(setup_of())
    layout = session.setup.agent.layout
    play(session, 20)
    session.person.take(18)
    session.person.move([1, -1, 0.5, 0])
    assert session.person.in_control
    play(session, 30)
    session.person.let_go(29)
    play(session, 48)
    rows = stored(session)
    np.testing.assert_array_equal(rows[20:30, layout.action], [[1, -1, 0.5, 0]] * 10)
    assert (rows[20:30, layout.reward] < -19).all()
    assert session.interventions == 1
    assert [n for n in range(48) if session.flag("control", n)] == list(range(20, 30))
    assert [n for n in range(48) if session.flag("dangerous", n)] == list(range(18, 29))
    session.person.undo()
    after = stored(session)
    np.testing.assert_allclose(
        after[20:30, layout.reward], rows[20:30, layout.reward] + 20, atol=1e-5
    )
    assert not any(session.flag("dangerous", n) for n in range(48))


def test_of_weight_0_only_the_feedback_is_learned_from():
    session = Session(setup_of(hyper=HYPER.replace(reward_weight=0.0)))
    play(session, 20)
    session.person.take(18)
    session.person.move([1, -1, 0.5, 0])
    play(session, 30)
    session.person.let_go(29)
    play(session, 48)
    rewards = stored(session)[:48, session.setup.agent.layout.reward]
    assert (rewards[20:30] == HYPER.feedback).all()
    assert not rewards[:20].any()
    assert not rewards[30:].any()
    shaped = np.array([step[Episode._fields.index("shaped")] for step in session._steps])
    assert not np.signbit(shaped[shaped == 0.0]).any()


def test_the_arbiter_hands_over_where_alarm_and_judgement_agree(silent):
    _, alarms = silent
    session = Session(setup_of())
    play(session, alarms[0])
    session.person.danger(True, alarms[0])
    session.person.danger(False, alarms[0])  # A tap counts, though it ends before the step.
    session.tick()
    assert session.person.in_control
    assert session.interventions == 1
    session.tick()
    assert session.interventions == 1
    session.person.safe(session.frame.number)
    assert not session.person.in_control


@pytest.mark.parametrize("intervention", ["takeover", "penalty", "reset"])
def test_a_judgement_that_comes_late_can_give_control_and_is_taken_back_whole(silent, intervention):
    """The frames between those that were judged and those of the control stay safe."""
    nobody, alarms = silent
    at = next(n for n in alarms if n - 4 not in alarms and n > 8)
    session = Session(setup_of(intervention))
    layout = session.setup.agent.layout
    play(session, at)
    session.person.danger(True, at - 4)
    session.person.danger(False, at - 4)
    assert [n for n in range(at) if session.flag("dangerous", n)] == [at - 4]
    play(session, at + 3)
    until = at + 3 if intervention == "takeover" else at + 1
    judged_now = [n for n in range(at + 3) if session.flag("dangerous", n)]
    assert judged_now == [at - 4, *range(at, until)]
    assert session.flag("control", at)
    # Who intervened judged the frame: the alarm was a true one.
    session.tick()
    assert session.frames(at, at + 1)[0, layout.boundary_reward] == 1.0
    if session.person.in_control:
        session.person.let_go(session.frame.number)
    session.person.safe(at - 4)
    assert not session.flag("dangerous", at - 4)
    session.person.undo()
    assert session.flag("dangerous", at - 4)
    session.person.undo()
    assert session.labels == []
    assert not any(session.flag("dangerous", n) for n in range(at + 4))
    # The boundary is again that of the session without a person.
    columns = [layout.boundary_reward, layout.boundary, layout.next_boundary]
    np.testing.assert_array_equal(
        session.frames(0, at)[:, columns], nobody.frames(0, at)[:, columns]
    )


@pytest.mark.parametrize("end", ["let_go", "safe", "undo"])
def test_a_judgement_that_is_corrected_in_time_gives_no_control(silent, end):
    _, alarms = silent
    session = Session(setup_of())
    play(session, alarms[0])
    session.person.danger(True, alarms[0])
    session.person.danger(False, alarms[0])
    getattr(session.person, end)(*([] if end == "undo" else [alarms[0]]))
    session.tick()
    # A tap that was over stays a judgement of its frame, unless it is called safe or taken back.
    assert session.person.in_control == (end == "let_go")


def test_a_human_reset_that_is_taken_back_does_not_end_the_bootstrap(silent):
    _, alarms = silent
    session = Session(setup_of("reset"))
    layout = session.setup.agent.layout
    play(session, alarms[0])
    session.person.danger(True, alarms[0])
    assert session.tick()["end"] == "human-reset"
    assert session.frame.ended
    session.person.danger(False, session.frame.number)
    play(session, 48)
    assert stored(session)[alarms[0], [layout.terminated, layout.truncated]].tolist() == [1, 0]
    session.person.undo()
    assert stored(session)[alarms[0], [layout.terminated, layout.truncated]].tolist() == [0, 1]


def test_assistance_walks_only_while_the_person_has_the_controls():
    session = Session(setup_of())
    session.person.assist(True)
    play(session, 5)
    session.person.take(5)
    play(session, 10)
    layout = session.setup.agent.layout
    scripted = session.actions(5, 10)
    assert np.abs(scripted).sum() > 0
    session.person.assist(False)
    session.tick()
    np.testing.assert_array_equal(session.actions(10, 11), np.zeros((1, layout.action_size)))


@pytest.mark.parametrize(
    ("do", "said"),
    [
        (lambda s: s.person.danger(True, 7), "frame 7: must be from 0 to 0"),
        (lambda s: s.person.danger(True, -1), "frame -1: must be from 0 to 0"),
        (lambda s: s.person.move([2.0, 0, 0, 0]), "hands: must be four numbers from -1 to 1"),
        (lambda s: s.person.move([0.0]), "hands: must be four numbers from -1 to 1"),
    ],
)
def test_what_cannot_be_done_is_refused(silent, do, said):
    fresh = Session(setup_of())
    with pytest.raises(ValueError, match=said):
        do(fresh)


def test_a_learner_that_diverged_moves_nothing():
    hyper = dataclasses.replace(HYPER, actor_learning_rate=1e30, critic_learning_rate=1e30)
    session = Session(setup_of(hyper=hyper))
    with pytest.raises(WalkerError, match="the learner diverged: its numbers are not finite"):
        play(session, 400)
    assert np.isfinite(session.frame.observation).all()


def test_line_8_after_the_fact_is_line_8():
    rng = np.random.default_rng(0)
    alarmed, dangerous, live = rng.random((3, 64)) < 0.6
    hyper = dataclasses.replace(HYPER, human_price=0.25)
    now, told, after, rewards = jax.tree.map(
        np.asarray, [0.3, *boundary_along(hyper, 0.3, alarmed, dangerous, live)]
    )
    for n in range(64):
        assert told[n] == pytest.approx(now, abs=1e-6)
        expected = boundary.next_boundary(now, alarmed[n], dangerous[n], 0.01, 0.01)
        assert after[n] == pytest.approx(np.clip(expected, 0.05, 1.5), abs=1e-6)
        assert rewards[n] == boundary.boundary_reward(alarmed[n], dangerous[n], 1.0, 0.25)
        now = after[n] if live[n] else now


def test_labels_cover_their_frames():
    labels = [
        Label(0, "danger", 2, 5),
        Label(1, "safe", 3, 4),
        Label(2, "take", 7, None),
        Label(3, "danger", 0, 0),
        Label(4, "danger", 4, 4),
    ]
    assert np.flatnonzero(judged(labels, 1, 10)).tolist() == [1, 3, 4, 6, 7, 8]
    assert judged(labels, 5, 5).shape == (0,)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "3",
        '{"type": "fly"}',
        '{"type": ["danger"]}',
        '{"type": "danger"}',
        '{"type": "danger", "down": 1, "frame": 3}',
        '{"type": "danger", "down": true, "frame": 3.5}',
        '{"type": "safe", "frame": true}',
        '{"type": "hands", "action": ["a"]}',
        '{"type": "hands", "action": [NaN, 0, 0, 0]}',
        '{"type": "hands", "action": [1%s, 0, 0, 0]}' % ("0" * 400),
        '{"type": "no_answer", "frame": 0}',
        '{"type": "speed", "factor": 3}',
        '{"type": "speed", "factor": true}',
        "[" * 100_000,
    ],
)
def test_messages_that_mean_nothing_are_refused_in_one_line(text):
    with pytest.raises(ValueError, match=r"^[^\n]+$"):
        messages.parse(text)


def test_a_session_begins_with_networks_that_were_learned(silent):
    session, _ = silent
    train, tau = session.networks()
    start = {
        "actor": train.learner.actor,
        "critic": train.learner.critic,
        "boundary_actor": train.boundary.actor,
        "boundary_critic": train.boundary.critic,
        "boundary": tau,
    }
    tested = Session(setup_of(start=start, learns=False))
    # The first episode of the sweep's test.
    first = VisibleWalker().reset(episode_seed("test", 0, 0))
    np.testing.assert_array_equal(tested.frame.observation, first)
    assert tested.frame.boundary == pytest.approx(float(tau))
    kept = tested.networks()[0].learner
    jax.tree.map(np.testing.assert_array_equal, kept.actor, start["actor"])
    play(tested, 32)
    other = dataclasses.replace(tested.setup.agent.config, hidden_sizes=(8,))
    agent = make_agent(other, judge=person.judge(), source=person.actions(4))
    with pytest.raises(ValueError, match="its actor has other layers"):
        Session(setup_of(agent=agent, start=start))


def test_learning_on_the_device_that_acts(monkeypatch):
    """Where an accelerator does both, the first average must not be the actor's own array."""
    monkeypatch.setattr(background_learner, "learning_devices", jax.devices)
    session = Session(setup_of())
    play(session, 96)
    assert session.updates > 0


@pytest.mark.usefixtures("compiled_fully")
def test_a_judgement_in_time_equals_one_that_came_late(silent):
    _, alarms = silent
    first, last = alarms[0], alarms[0] + 6
    in_time, late = Session(setup_of("penalty")), Session(setup_of("penalty"))
    play(in_time, first)
    in_time.person.danger(True, first)
    play(in_time, last)
    in_time.person.danger(False, last - 1)
    play(late, last)
    late.person.danger(True, first)
    late.person.let_go(last)  # Or the arbiter might intervene now.
    columns = [
        late.setup.agent.layout.boundary_reward,
        *(late.setup.agent.layout.boundary + i for i in (0, 1)),
    ]
    play(in_time, 48)
    play(late, 48)
    np.testing.assert_array_equal(stored(in_time)[:, columns], stored(late)[:, columns])
    assert in_time.frame.boundary == late.frame.boundary


@pytest.mark.usefixtures("compiled_fully")
@pytest.mark.parametrize("ticks", [1, 40])
def test_what_is_taken_back_leaves_no_trace(silent, ticks):
    """Boundary and stored rewards, also of frames that the learner had already."""
    _, alarms = silent
    session = Session(setup_of())
    play(session, 45)
    silence = next(n for n in range(45) if n not in alarms)
    session.person.danger(True, silence)
    session.person.danger(False, min(alarms[0] + 3, 44))
    session.person.safe(44)
    session.person.undo()
    label = session.person.undo()
    assert (label.kind, label.first) == ("danger", silence)
    assert session.labels == []
    play(session, 45 + ticks)
    quiet = Session(setup_of())
    play(quiet, 45 + ticks)
    assert session.digest() == quiet.digest()
    np.testing.assert_array_equal(stored(session), stored(quiet))
