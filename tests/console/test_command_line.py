"""The words of a command line, however it is started."""

import sys

import pytest

from hitl_jax.__main__ import main
from hitl_jax.commands import figures


@pytest.mark.parametrize("words", [None, ["figures", "a folder"]])
def test_a_command_sees_its_own_options(monkeypatch, words):
    """`hitl-jax figures ...` and `python -m experiments.figures ...`; folders keep these words."""
    seen = []

    def noted(options: figures.Options) -> int:
        seen.append((options.results.name, sys.argv[1:]))
        return 0

    typed = ["figures", "a folder"] if words is None else ["a folder"]
    monkeypatch.setattr(sys, "argv", ["hitl-jax", *typed])
    monkeypatch.setattr(figures, "main", noted)
    assert main(words) == 0
    assert seen == [("a folder", ["a folder"])]


@pytest.mark.parametrize("words", [["nonsense"], ["Sweep"], ["sweep "], [""]])
def test_other_commands_are_refused(words, capsys):
    assert main(words) == 2
    assert f"error: {words[0]}: must be one of sweep, figures" in capsys.readouterr().err


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"]])
def test_without_a_command_all_are_listed(words, capsys):
    assert main(words) == 0
    assert "boundary-map" in capsys.readouterr().out
