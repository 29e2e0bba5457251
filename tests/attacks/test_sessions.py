"""Journals that are no files, and a page's token that others on the machine must not see."""

import json
import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from live_team import setup_of

from hitl_jax.commands import live
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.live import address, journal
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.session import Session
from hitl_jax.results.atomic_files import write_bytes_atomic

_HEADER = LiveOptions().header()


def _begun(path):
    noted = journal.Journal(path)
    noted.begin(_HEADER)
    return noted


@pytest.mark.parametrize("kind", ["fifo", "folder", "link", "dangling", "hard link", "device"])
def test_what_is_no_file_is_no_journal(tmp_path, kind, capsys):
    path, users = tmp_path / "session.jsonl", tmp_path / "thesis.tex"
    users.write_text("years of work")
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(users)
    elif kind == "dangling":
        path.symlink_to(tmp_path / "new")
    elif kind == "hard link":
        os.link(users, path)
    else:
        path.symlink_to("/dev/null")
    options = ["--journal", str(path), "--no-open-page", "--port", "0"]
    assert run_main("live", live.main, options) == 2
    said = capsys.readouterr().err
    assert said == f"error: --journal {path}: must be a plain file of one name, or not there: " + (
        "copy it\n"
    )
    assert users.read_text() == "years of work"
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "text",
    [
        '{"journal":"Nature","title":"x"}',
        '{"journal":"Nature"}\n{"more":1}',
        '{"journal": 3}',
        "{}",
    ],
)
def test_a_file_of_something_else_is_left_as_it_is(tmp_path, text):
    path = tmp_path / "refs.json"
    path.write_text(text)
    noted = journal.Journal(path)
    assert not noted.is_new
    noted.close()
    with pytest.raises(ResultsError, match="journal"):
        journal.read(path)
    assert path.read_text() == text


@pytest.mark.parametrize("letter", ["a", "ü"])
def test_a_name_to_which_nothing_can_be_added_is_refused_at_the_start(tmp_path, letter, capsys):
    most = os.pathconf(tmp_path, "PC_NAME_MAX")
    for size in (most, most - 5):
        path = tmp_path / (letter * (size // len(letter.encode())))
        options = ["--journal", str(path), "--no-open-page", "--port", "0"]
        assert run_main("live", live.main, options) == 2
        assert f"its name must be of at most {most - 10} bytes" in capsys.readouterr().err
        assert not path.exists()
    longest = tmp_path / ("a" * (most - 10))
    _begun(longest).close()
    for ending in journal.COMPANION_ENDINGS:
        write_bytes_atomic(longest.with_name(longest.name + ending), b"")


@pytest.mark.parametrize("how", ["removed", "renamed", "replaced", "linked"])
def test_a_journal_that_is_taken_away_is_noticed(tmp_path, how):
    path, session = tmp_path / "session.jsonl", Session(setup_of())
    noted = _begun(path)
    if how == "renamed":
        path.rename(tmp_path / "away")
    else:
        path.unlink()
    if how == "replaced":
        second = _begun(path)  # Of a session that was started meanwhile.
    elif how == "linked":
        (tmp_path / "other").write_text("mine")
        path.symlink_to(tmp_path / "other")
    before = path.read_bytes() if path.exists() else None
    with pytest.raises(ResultsError, match="was removed, or another file was put in its place"):
        noted.said(session, {"type": "undo"})
    assert (path.read_bytes() if path.exists() else None) == before
    noted.close()
    if how == "replaced":
        second.said(session, {"type": "undo"})
        second.close()
        assert len(journal.read(path)[1]) == 1


def _lines(path):
    session, noted = Session(setup_of()), _begun(path)
    for said in ({"type": "danger", "down": True, "frame": 0}, {"type": "undo"}):
        noted.said(session, said)
    while session.frame.number < 20:
        session.tick()
        noted.played(session)
    noted.close()
    return path.read_bytes().splitlines(keepends=True)


def test_a_line_that_is_missing_swapped_or_changed_is_noticed(tmp_path):
    path = tmp_path / "session.jsonl"
    head, first, second, chunk = _lines(path)
    assert len(journal.read(path)[1]) == 3
    for lines in (
        [head, second, chunk],
        [head, first, chunk],
        [head, second, first, chunk],
        [head, first, first, second, chunk],
        [head, first.replace(b"true", b"false"), second, chunk],
        [head, first, second, chunk.replace(b'"at":16', b'"at":32')],
        [first, second, chunk],
    ):
        path.write_bytes(b"".join(lines))
        with pytest.raises(ResultsError, match=r"line \d: is damaged: its checksum|must be 3"):
            journal.read(path)


def test_a_journal_of_the_version_before_goes_on_as_it_was(tmp_path):
    """Its lines have no checksums: those that are added have none either."""
    path = tmp_path / "session.jsonl"
    lines = [json.loads(line) for line in _lines(path)]
    lines[0]["journal"] = 2
    for line in lines:
        del line["sum"]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    session = Session(setup_of())
    noted = journal.Journal(path)
    for _ in journal.play(session, journal.read(path)[1], path):
        pass
    noted.said(session, {"type": "undo"})
    noted.close()
    header, others = journal.read(path)
    assert header["journal"] == 2
    assert others[-1]["said"] == {"type": "undo"}
    assert b'"sum"' not in path.read_bytes()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"at": 0, "said": {"type": "danger", "down": True, "frame": None}}, "frame must be"),
        ({"at": 0, "said": {"type": "hands", "action": {}}}, "action must be of type list"),
        ({"at": 0, "said": {"type": "hands", "action": [True]}}, "action must be numbers"),
        ({"at": 0, "said": {"type": "hands", "action": [10**400]}}, "out of range|numbers"),
        ({"at": 0, "said": {"type": "undo", "more": 1}}, "its fields must be"),
        ({"at": 0, "said": {"type": "gone"}}, "its fields must be"),
        ({"at": 0, "said": {"type": ["undo"]}}, "its type must be one of"),
        ({"at": 0, "said": []}, "Expected `object`"),
        ({"at": -1, "said": {"type": "undo"}}, "Expected `int` >= 0"),
        ({"at": 2**60, "said": {"type": "undo"}}, "Expected `int` <="),
        ({"at": 0, "said": {"type": "undo"}, "label": {"kind": 3}}, "label|missing"),
        ({"at": 16, "actions": 3, "digest": "x"}, "Expected `str`"),
        ({"at": 16, "actions": "\u00fc", "digest": "x"}, "matching regex"),
        ({"at": 16, "actions": "AAAA", "digest": None}, "Expected `str`"),
    ],
)
def test_a_line_that_no_session_has_noted_is_refused(tmp_path, line, said):
    path = tmp_path / "session.jsonl"
    texts = [json.dumps(one) + "\n" for one in ({"journal": 2, **_HEADER}, line)]
    path.write_text("".join(texts))
    with pytest.raises(ResultsError, match=f"line 2: is damaged: .*({said})"):
        journal.read(path)


def test_a_frame_far_ahead_is_not_played_for_ever(tmp_path):
    path = tmp_path / "session.jsonl"
    line = {"at": 10**12, "said": {"type": "undo"}}
    path.write_text(json.dumps({"journal": 2, **_HEADER}) + "\n" + json.dumps(line) + "\n")
    session = Session(setup_of())
    with pytest.raises(ResultsError, match="lines are missing before it"):
        list(journal.play(session, journal.read(path)[1], path))
    assert session.frame.number == 0


# ----------------------------------------------------------------------------------- the token


_BROWSER = """
import pathlib, sys, time
arguments = pathlib.Path("/proc/self/cmdline").read_bytes().decode()
kept, address = sys.argv[1:]
page = pathlib.Path(address.removeprefix("file://"))
told = [arguments, str(page.stat().st_mode), page.read_text()]
pathlib.Path(kept).write_text("\\n".join(told))
"""


def test_the_token_is_in_no_command_line(tmp_path, monkeypatch):
    """The browser gets the name of a file that only the user can read."""
    program, kept = tmp_path / "browser.py", tmp_path / "kept"
    program.write_text(_BROWSER)
    page_address = "http://127.0.0.1:8765/?token=secret"
    path = tmp_path / "session.jsonl"

    def open_in(url):
        subprocess.run([sys.executable, str(program), str(kept), url], check=True)

    monkeypatch.setattr(address.webbrowser, "open", open_in)
    old = os.umask(0)
    try:
        with address.opened(page_address, path):
            assert len(list(tmp_path.glob("*.html"))) == 1
    finally:
        os.umask(old)
    arguments, mode, page = kept.read_text().split("\n", 2)
    assert "secret" not in arguments
    assert stat.S_IMODE(int(mode)) == 0o600
    assert f"url={page_address}" in page
    assert not list(tmp_path.glob("*.html"))


def test_a_link_where_the_file_would_be_is_replaced_and_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(address.webbrowser, "open", lambda url: None)
    users = tmp_path / "thesis.tex"
    users.write_text("years of work")
    path = tmp_path / "session.jsonl"
    path.with_name(path.name + journal.REDIRECT_ENDING).symlink_to(users)
    with address.opened("http://127.0.0.1:1/?token=secret", path):
        pass
    assert users.read_text() == "years of work"


@pytest.mark.parametrize("kind", ["vector", "string", "layers"])
def test_what_it_begins_with_is_checked(tmp_path, kind, capsys):
    path = tmp_path / "start.npz"
    arrays = {"boundary": np.float32(0.7)}
    arrays |= {
        "vector": {"boundary": np.zeros(3, np.float32)},
        "string": {"actor/params/Dense_0/kernel": np.array("x")},
        "layers": {"actor/params/Dense_0/kernel": np.zeros((3, 3), np.float32)},
    }[kind]
    np.savez(path, **arrays)
    for option in ("--start", "--human-policy"):
        options = [option, str(path), "--journal", str(tmp_path / "j"), "--no-open-page"]
        assert run_main("live", live.main, options) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"error: {option} {path}: ")
        assert said.count("\n") == 1
