"""A results folder and a journal of an earlier commit (6b71abc): they open, draw and play again.

The folder: `hitl-jax sweep --seeds 2 --episodes 5 --test-episodes 2 --warmup-steps 200
--capacity 4000 --hidden-sizes 8 8 --boundary-hidden-sizes 4 4`, without its figures.
"""

import pathlib
import re
import shutil

import pytest

from hitl_jax.__main__ import main
from hitl_jax.live import journal
from hitl_jax.results.episode_tables import ENDS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey

pytestmark = pytest.mark.usefixtures("compiled_fully")

_HERE = pathlib.Path(__file__).parent


@pytest.fixture
def old(tmp_path):
    shutil.copytree(_HERE / "sweep", tmp_path / "sweep")
    return tmp_path / "sweep"


def test_it_opens(old):
    folder = ResultsFolder(old)
    keys = folder.finished()
    assert len(keys) == 6
    episodes = folder.load_run(RunKey("hitl-ac", 0)).episodes
    assert len(episodes["return"]) == 5
    assert set(episodes["end"].tolist()) <= set(ENDS)


def test_it_is_drawn(old, capsys):
    assert main(["figures", str(old)]) == 0
    assert (old / "figures" / "figure6_boundary.png").exists()
    assert "error" not in capsys.readouterr().err


def test_an_episode_is_filmed(old):
    film = old.parent / "film.gif"
    words = ["replay", str(old), "--method", "hitl-ac", "--seed", "0", "--out", str(film)]
    assert main(words) == 0
    assert film.stat().st_size > 1000


@pytest.mark.slow
def test_its_recorded_episodes_give_the_same_returns(old, capsys):
    """Those of training, from their actions; tests are played anew and may round otherwise."""
    main(["verify", str(old), "--runs", "6"])
    told = [line for line in capsys.readouterr().out.splitlines() if " training " in line]
    counts = [re.search(r"training (\d) of (\d)", line).groups() for line in told]
    assert len(counts) == 6
    assert all(same == played for same, played in counts)


def test_its_journal_opens():
    header, lines = journal.read(_HERE / "session.jsonl")
    assert header["journal"] == 3
    assert lines[-1]["at"] == 800


@pytest.mark.slow
def test_its_journal_plays_again_or_says_what_differs(tmp_path, capsys):
    """To the last bit on a machine of that kind; elsewhere one line says that it cannot."""
    path = tmp_path / "session.jsonl"
    shutil.copy(_HERE / "session.jsonl", path)
    code = main(["recorded", str(path)])
    told = capsys.readouterr()
    if code == 0:
        assert "796 steps of 5 episodes" in told.out
    else:
        assert "rounds otherwise" in told.err
        assert "Traceback" not in told.err
