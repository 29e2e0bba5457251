"""A guided session: consent, a stretch of play, six questions; and a table of several people."""

import csv
import dataclasses
import json

import numpy as np
import pytest
import small
import tyro
from live_team import Served, say, setup_of, until_update

from hitl_jax.commands import live, participants
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.live import journal, messages
from hitl_jax.live.begin import setup_of as setup_from
from hitl_jax.live.guide import SCALES, Guide, GuideOptions, agreement, require_same
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.participants import Participant, csv_table, report
from hitl_jax.live.session import Session

_ANSWERS = [0, 20, 40, 60, 80, 100]


def test_each_stage_follows_from_what_was_said_and_played():
    guide = Guide(GuideOptions("I agree.", 10))
    assert guide.stage(0) == "consent"
    for kind in ("danger", "pause", "questionnaire"):
        with pytest.raises(ValueError, match=f"^{kind}: the person has not agreed"):
            guide.hear(kind, 0)
    guide.hear("consent", 0)
    assert (guide.stage(9), guide.stage(10)) == ("play", "questions")
    guide.hear("danger", 9)
    with pytest.raises(ValueError, match=r"^take: the session is over, the questions come$"):
        guide.hear("take", 10)
    with pytest.raises(ValueError, match=r"^consent: the session is played$"):
        guide.hear("consent", 9)
    guide.hear("questionnaire", 10)
    assert guide.stage(10) == "end"
    again = Guide(GuideOptions("I agree.", 10), ["consent", "danger"])
    assert (again.stage(3), again.stage(11)) == ("play", "questions")


def test_who_is_not_guided_is_asked_for_nothing():
    guide = Guide(None)
    assert guide.stage(10**9) == "play"
    with pytest.raises(ValueError, match=r"^consent: the session is played$"):
        guide.hear("consent", 0)


@pytest.mark.parametrize("answers", [[], [5] * 5, [5] * 7, [3] * 6, [105] * 6, [-5] * 6, [2.5] * 6])
def test_answers_are_six_on_the_scale(answers):
    said = {"type": "questionnaire", "answers": answers}
    with pytest.raises(ValueError, match=r"^questionnaire: answers must be 6 numbers from 0 to"):
        messages.parse(json.dumps(said))
    with pytest.raises(ValueError, match=r"^questionnaire: answers must be"):
        messages.require_known(said)


def test_a_person_is_led_from_consent_to_the_end(tmp_path):
    path, guide = tmp_path / "journal.jsonl", GuideOptions("I agree to all.", 40)
    session = Session(setup_of(learns=False))
    with Served(session, path, guide=guide) as served, served.open() as page:
        hello = until_update(page, "hello")
        assert hello["guide"]["consent"] == "I agree to all."
        say(page, "take", frame=0)
        assert "has not agreed" in until_update(page, "error")["message"]
        assert until_update(page, "status")["stage"] == "consent"
        assert session.frame.number == 0
        say(page, "consent")
        say(page, "speed", factor=8.0)
        assert "is played in real time" in until_update(page, "error")["message"]
        say(page, "danger", down=True, frame=0)
        until_update(page, "status", lambda status: status["stage"] == "questions")
        assert session.env_steps == 40
        assert not session.person.dangerous  # What was held was let go.
        say(page, "questionnaire", answers=[1] * 6)
        assert "in steps of 5" in until_update(page, "error")["message"]
        say(page, "questionnaire", answers=_ANSWERS)
        until_update(page, "status", lambda status: status["stage"] == "end")
        status, text = served.page(f"/journal?token={served.address.partition('token=')[2]}")
        assert (status, text) == (200, path.read_text())
        assert served.page("/journal")[0] == 403
        page.close()
        served._thread.join(20)
        assert not served._thread.is_alive()  # It ends by itself.
    said = [line["said"] for line in journal.read(path)[1] if "said" in line]
    assert said[0] == {"type": "consent", "text": "I agree to all."} | {
        **{"steps": 40, "asks": False, "answer_seconds": 5.0}
    }
    assert {"type": "questionnaire", "answers": _ANSWERS} in said
    again = Session(setup_of(learns=False))
    list(journal.play(again, journal.read(path)[1], path))
    assert again.digest() == session.digest()


def test_a_guided_session_goes_on_where_it_was_closed(tmp_path):
    path, guide = tmp_path / "journal.jsonl", GuideOptions("Yes.", 60)
    session = Session(setup_of(learns=False))
    with Served(session, path, guide=guide) as served, served.open() as page:
        say(page, "consent")
        until_update(page, "frame", lambda frame: frame["n"] >= 10)
    with Served(session, path, guide=guide) as served, served.open() as page:
        assert until_update(page, "status")["stage"] == "play"
        until_update(page, "status", lambda status: status["stage"] == "questions")


_WORDS = ["--warmup-steps", "64", "--initial-boundary", "0.1", *small.OPTIONS, "--guided"]


@pytest.fixture(scope="module")
def options():
    return tyro.cli(LiveOptions, args=[*_WORDS, "--guided-steps", "150"]).checked()


def _play(options, path, tolerance, answers=None):
    """A session of a person who calls all beyond an angle dangerous, at once."""
    session, noted = Session(setup_from(options)), journal.Journal(path)
    noted.begin(options.header())
    noted.said(session, agreement(options.guide))
    while session.env_steps < options.guided_steps:
        frame = session.frame
        dangerous = abs(float(frame.observation[0])) > tolerance
        if dangerous != session.person.dangerous and not frame.ended:
            # "Safe" lets go of the controls too, which an alarm may have given.
            said = {"type": "danger", "down": True} if dangerous else {"type": "safe"}
            noted.said(session, {**said, "frame": frame.number})
        session.tick()
        noted.played(session)
    if answers:
        noted.said(session, {"type": "questionnaire", "answers": answers})
    noted.close()


@pytest.mark.slow
def test_several_people_become_one_table_beside_simulated_humans(options, tmp_path, capsys):
    _play(options, tmp_path / "anna.jsonl", 0.2, _ANSWERS)
    _play(options, tmp_path / "ben.jsonl", 9.0)
    assert run_main("participants", participants.main, [str(tmp_path)]) == 0
    said = capsys.readouterr().out
    with open(tmp_path / "participants.csv") as file:
        anna, ben, ideal, person = csv.DictReader(file)
    assert [one["name"] for one in (anna, ben, ideal, person)] == [
        *("anna", "ben", "simulated: ideal", "simulated: person")
    ]
    assert [float(anna[name]) for name in SCALES] == _ANSWERS
    assert float(anna["workload"]) == 50
    assert float(anna["tolerance"]) == pytest.approx(0.2, abs=0.05)
    assert float(ben["dangerous"]) == 0
    assert {ben["workload"], ben["tolerance"], ideal["effort"]} == {""}
    assert {float(one["minutes"]) for one in (anna, ideal, person)} == {150 / 3000}
    assert 149 - 16 <= float(ben["minutes"]) * 3000 <= 150  # Steps after a journal's end are lost.
    assert said.endswith((tmp_path / "participants.md").read_text())
    assert "| anna |" in said


def test_the_table_has_a_line_for_each_human_and_nothing_where_there_is_none():
    nan = float("nan")
    anna = Participant(
        *("a|b", 5.0, 3, 2, -80.5, 0.25, 40, 0.5, 12.0, 0.31, 10, 0.125, 50.0),
        answers=tuple(map(float, _ANSWERS)),
    )
    idle = Participant("ben", 0.1, 0, 0, nan, 0.0, 0, nan, 0.0, nan, nan, nan, nan, (nan,) * 6)
    _, _, first, second = report([anna, idle]).splitlines()
    assert first == (
        r"| a\|b | 5.0 | 3 | 2 | -80 | 25.0% | 40 | 50% | 12 | 0.31 | 0.20 | 12.5% | 50 |"
    )
    assert second == "| ben | 0.1 | 0 | 0 |  | 0.0% | 0 |  | 0 |  |  |  |  |"
    columns = csv_table([anna, idle])
    assert [columns[name][0] for name in SCALES] == _ANSWERS
    assert np.isnan(columns["workload"][1])
    assert next(iter(columns)) == "name" and "answers" not in columns


def test_sessions_that_began_otherwise_are_not_compared(options, tmp_path, capsys):
    def begin(name, seed=0, asks=False):
        noted = journal.Journal(tmp_path / f"{name}.jsonl")
        noted.begin({**options.header(), "seed": seed})
        said = agreement(options.guide._replace(asks=asks))
        noted._add({"at": 1, "said": said, "time": 0.0})
        noted.close()

    def refused():
        assert run_main("participants", participants.main, [str(tmp_path)]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said

    begin("anna")
    begin("ben", seed=1)
    assert "ben.jsonl: its session has seed 1, that of anna.jsonl 0: sessions that" in refused()
    (tmp_path / "ben.jsonl").unlink()
    begin("ben", asks=True)
    assert "its session has guide.asks True, that of anna.jsonl False" in refused()


@pytest.mark.parametrize(
    ("changes", "lines", "said"),
    [
        (None, "consent", "is guided, asked for otherwise"),
        ({}, "danger", "is not guided, asked for otherwise"),
        ({"steps": 9}, "consent", "its person agreed to steps 150, asked for 9"),
        ({"consent": "Other."}, "consent", "its person agreed to text While you play"),
        ({}, "questionnaire", "its session has ended"),
        (None, "questionnaire", "its session has ended"),
    ],
)
def test_a_session_goes_on_as_it_was_agreed(options, changes, lines, said, tmp_path):
    consent = agreement(options.guide)
    noted = {"consent": [consent], "danger": [{"type": "danger"}]}
    noted["questionnaire"] = [consent, {"type": "questionnaire"}]
    lines = [{"at": 1, "said": one} for one in noted[lines]]
    guide = None if changes is None else options.guide._replace(**changes)
    with pytest.raises(ResultsError, match=said):
        require_same(tmp_path, lines, guide)
    require_same(tmp_path, [], guide)
    require_same(tmp_path, [{"at": 1, "said": consent}], options.guide)
    # Whoever closes the page before they agree is noted as gone, and may come again.
    require_same(tmp_path, [{"at": 0, "said": {"type": "gone", "frame": 0}}], guide)


def test_what_nobody_played_is_left_out(options, tmp_path, capsys):
    (tmp_path / "empty.jsonl").write_text("")
    noted = journal.Journal(tmp_path / "begun.jsonl")
    noted.begin(options.header())
    noted._add({"at": 0, "said": {"type": "gone", "frame": 0}, "time": 0.0})
    noted.close()
    assert run_main("participants", participants.main, [str(tmp_path)]) == 2
    told = capsys.readouterr()
    assert told.out.count("nothing was played; it is left out") == 2
    assert "has no journal of a session that was played" in told.err


def test_a_consent_of_several_lines_is_kept_as_one(options):
    text = "I agree.\n\tI am\u00a018 or older."
    assert dataclasses.replace(options, consent=text).checked().guide.consent == (
        "I agree. I am 18 or older."
    )


def test_only_a_guided_session_gives_its_journal(served):
    token = served.address.partition("token=")[2]
    assert served.page(f"/journal?token={token}")[0] == 404


@pytest.mark.parametrize(
    ("folder", "said"),
    [("none", "must be a folder of journals"), (".", "has no journal of a session")],
)
def test_a_folder_without_sessions_is_one_line(folder, said, tmp_path, capsys):
    assert run_main("participants", participants.main, [str(tmp_path / folder)]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--guided", "--mode", "watch"], "--guided True: there is nobody to guide with --mode"),
        (["--guided", "--guided-steps", "0"], "--guided-steps 0: must be at least 1"),
        (["--guided-steps", "99"], "--guided-steps: needs --guided"),
        (["--consent", "Yes."], "--consent: needs --guided"),
        (["--guided", "--consent", " "], "--consent ' ': must be a text of 1 to 2000 characters"),
        (["--guided", "--consent", "\x1b[2J"], "--consent '\\x1b[2J': must be a text of"),
    ],
)
def test_what_a_guided_session_cannot_be_is_one_line(words, said, capsys):
    assert run_main("live", live.main, words) == 2
    error = capsys.readouterr().err
    assert f"error: {said}" in error and error.count("\n") == 1


def test_a_session_that_has_ended_does_not_go_on(options, tmp_path, capsys):
    path = tmp_path / "anna.jsonl"
    noted = journal.Journal(path)
    noted.begin(options.header())
    noted._add({"at": 0, "said": {"type": "questionnaire", "answers": _ANSWERS}, "time": 0.0})
    noted.close()
    words = [*_WORDS, "--no-open-page", "--port", "0", "--journal", str(path)]
    assert run_main("live", live.main, words) == 2
    assert "its session has ended: name another journal" in capsys.readouterr().err
