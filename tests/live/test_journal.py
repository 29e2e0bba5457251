"""The journal of a live session plays it again, whenever the process was killed."""

import json

import numpy as np
import pytest
from live_team import play, setup_of, stored

from hitl_jax.errors import ResultsError
from hitl_jax.live import journal, messages
from hitl_jax.live.labels import judged
from hitl_jax.live.session import Session
from hitl_jax.training.run_spec import LoopConfig


def _act_upon(noted, session, upto, rng, share=0.2):
    """Plays a session and sends random messages of a person."""
    while session.frame.number < upto:
        number, lottery = session.frame.number, rng.random()
        seen = max(number - int(rng.integers(0, 20)), 0)
        said = {
            0: {"type": "danger", "down": bool(rng.random() < 0.5), "frame": seen},
            1: {"type": "take", "frame": seen},
            2: {"type": "let_go", "frame": seen},
            3: {"type": "hands", "action": rng.uniform(-1, 1, 4).round(3).tolist()},
            4: {"type": "undo"},
            5: {"type": "safe", "frame": seen},
            6: {"type": "assist", "on": bool(rng.random() < 0.5)},
            7: {"type": "pause", "on": True},
        }
        if lottery < share:
            noted.said(session, messages.parse(json.dumps(said[int(rng.integers(8))])))
        elif lottery < share + 0.005:
            noted.said(session, {"type": "gone", "frame": seen - 1})
        session.tick()
        noted.played(session)


def test_a_journal_plays_the_session_again(tmp_path):
    path, rng = tmp_path / "journal.jsonl", np.random.default_rng(1)
    session = Session(setup_of())
    noted = _begun(path)
    _act_upon(noted, session, 1700, rng)  # More than the replay and than an episode hold.
    assert session.episodes
    # A process that is killed while it writes leaves a part of a line.
    path.write_bytes(path.read_bytes() + b'{"at":1701,"sa')
    header, lines = journal.read(path)
    assert header == {"journal": journal.VERSION, "mode": "train"}
    again = Session(setup_of())
    list(journal.play(again, lines, path))
    play(again, session.frame.number)
    assert again.digest() == session.digest()
    assert again.labels == session.labels
    assert repr(again.episodes) == repr(session.episodes)  # As text, since NaN differs from itself.
    np.testing.assert_array_equal(stored(again), stored(session))
    # It goes on in the same file, without the part of a line.
    with pytest.raises(ResultsError, match="another process plays this session"):
        journal.Journal(path)
    noted.close()
    noted = journal.Journal(path)
    assert not noted.is_new
    _act_upon(noted, again, 1760, rng)
    noted.close()
    assert all(json.loads(line) for line in path.read_text().splitlines())
    # The flags of the kept frames are those of the labels.
    played = again.frame.number
    kept = range(max(played - again.setup.loop.frames, 0), played)
    said = judged(again.labels, kept.start, kept.stop)
    for number, dangerous in zip(kept, said, strict=True):
        assert again.flag("dangerous", number) == (dangerous and again.flag("live", number))


def _begun(path):
    noted = journal.Journal(path)
    assert noted.is_new
    noted.begin({"mode": "train"})
    return noted


@pytest.mark.parametrize("torn", ["", '{"jour', '{"journal":2,"mode":"tr'])
def test_a_journal_that_was_killed_at_its_first_line_begins_anew(tmp_path, torn):
    path = tmp_path / "journal.jsonl"
    path.write_text(torn)
    _begun(path).close()
    assert journal.read(path) == ({"journal": journal.VERSION, "mode": "train"}, [])


def test_what_is_no_journal_is_left_as_it_is(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("a thought\nand its beginn")
    journal.Journal(path).close()
    with pytest.raises(ResultsError, match="is no journal of a live session"):
        journal.read(path)
    assert path.read_text() == "a thought\nand its beginn"


def test_a_line_that_the_disk_refuses_leaves_nothing(tmp_path, monkeypatch):
    path, session = tmp_path / "journal.jsonl", Session(setup_of())
    noted = _begun(path)
    before, write = path.read_bytes(), journal.os.write
    monkeypatch.setattr(journal.os, "write", lambda file, text: write(file, text[:20]))
    with pytest.raises(ResultsError, match="No space left on device"):
        noted.said(session, {"type": "undo"})
    noted.close()
    assert path.read_bytes() == before


@pytest.mark.slow
def test_ten_minutes_killed_at_any_moment_play_again(tmp_path):
    """At a random one of 30,000 frames. The checksums of all chunks are compared as it plays."""
    path, chance = tmp_path / "journal.jsonl", np.random.default_rng()
    # It learns a little, to end sooner.
    setup = setup_of(loop=LoopConfig(capacity=512, chunk=64, updates_per_step=1 / 32))
    session, noted = Session(setup), _begun(path)
    moment = int(chance.integers(1, 30_001))
    _act_upon(noted, session, moment, np.random.default_rng(3), share=0.02)
    noted.close()
    written = path.read_bytes()
    first = max(written.index(b"\n") + 1, len(written) - 200)
    kept = int(chance.integers(first, len(written) + 1))
    path.write_bytes(written[:kept])
    print(f"killed at frame {moment}, as byte {kept} was written")  # Shown where it fails.
    _, lines = journal.read(path)
    again = Session(setup)
    list(journal.play(again, lines, path))
    assert again.frame.number == (lines[-1]["at"] if lines else 0)


def test_another_session_is_noticed(tmp_path):
    path = tmp_path / "journal.jsonl"
    session = Session(setup_of())
    noted = _begun(path)
    _act_upon(noted, session, 64, np.random.default_rng(2))
    noted.close()
    header, lines = journal.read(path)
    with pytest.raises(ResultsError, match="plays otherwise than it did"):
        list(journal.play(Session(setup_of(seed=1)), lines, path))
    said = {"type": "danger", "down": True, "frame": 999}
    with pytest.raises(ResultsError, match="at frame 0: frame 999: must be from 0 to 0"):
        list(journal.play(Session(setup_of()), [{"at": 0, "said": said}], path))
    for line in ("3", "{}", '{"at": 1}', '{"at": "1", "said": {}}', '{"at": 1, "said": {}}'):
        path.write_text(f"{json.dumps(header | {'journal': 2})}\n{line}\n")  # Without checksums.
        with pytest.raises(ResultsError, match="line 2: is damaged"):
            journal.read(path)
    for text in ("", "{}\n", '{"journal": 9}\n', "hello\n", "[]\n"):
        path.write_text(text)
        with pytest.raises(ResultsError, match="journal"):
            journal.read(path)
    with pytest.raises(ResultsError, match="No such file"):
        journal.read(tmp_path / "none")
