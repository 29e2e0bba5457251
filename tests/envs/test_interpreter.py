"""Child processes import the modules of this process, whatever files are in the current folder."""

import os
import pathlib
import subprocess
import sys

import pytest
import small

import hitl_jax
from hitl_jax.envs.interpreter import child_interpreter

_NAMES = ("random", "numpy", "types", "jax", "matplotlib", "gymnasium", "hitl_jax", "experiments")
_CHECKOUT = str(pathlib.Path(hitl_jax.__file__).parents[1])

_SWEEP = """
import sys
from hitl_jax.__main__ import main
from hitl_jax.sweep.background_figures import BackgroundFigures

def draw(figures):
    figures.draw_now()
    print("the drawing ended with", figures.drawing.wait())

BackgroundFigures.stop = draw
sys.exit(main(["sweep", *sys.argv[1:]]))
"""


@pytest.fixture
def shadowing(tmp_path, monkeypatch):
    """A current folder with a module of each name, none of which may be imported."""
    for number, name in enumerate(_NAMES):
        path = tmp_path / f"{name}.py"
        if number % 2:
            path = tmp_path / name / "__init__.py"
            path.parent.mkdir()
        path.write_text("raise SystemExit('the wrong one was imported')")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _child(program):
    python, environment = child_interpreter()
    done = subprocess.run(
        [*python, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


@pytest.mark.usefixtures("shadowing")
def test_the_current_folder_shadows_nothing():
    program = f"import {', '.join(_NAMES[:3])}, hitl_jax; print(hitl_jax.__file__)"
    assert _child(program) == [hitl_jax.__file__]


def test_folders_are_those_of_this_process(tmp_path, monkeypatch):
    """An added folder comes before the current one; entries that are no strings are dropped."""
    (tmp_path / "added").mkdir()
    for folder in (tmp_path, tmp_path / "added"):
        (folder / "a_module_of_mine.py").write_text(f"print({str(folder)!r})")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path, tmp_path])
    assert _child("import a_module_of_mine") == [str(tmp_path)]
    monkeypatch.setattr(sys, "path", ["added", *sys.path])
    assert _child("import a_module_of_mine") == [str(tmp_path / "added")]


def test_the_environment_is_a_copy(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "before")
    _, environment = child_interpreter()
    environment["PYTHONPATH"] += os.pathsep + "more"
    assert os.environ["PYTHONPATH"] == "before"


@pytest.mark.slow
def test_a_sweep_beside_modules_of_the_same_names(shadowing):
    """The sweep's worker processes and its drawing process import the right modules."""
    words = ["--methods", "srl", "--seeds", "1", "--episodes", "2", "--test-episodes", "1"]
    words += ["--warmup-steps", "100", "--workers", "2", *small.OPTIONS, "--out", "results"]
    environment = {**os.environ, "PYTHONPATH": _CHECKOUT}
    command = [sys.executable, "-P", "-c", _SWEEP, *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "the drawing ended with 0" in done.stdout
    assert (shadowing / "results" / "figures").is_dir()
