"""Commands and pools on a machine without Box2D, as with Python 3.14.

A module that stands in for Box2D raises at its import.
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys

import official as theirs
import pytest
import small
from forged import of_config

from hitl_jax.commands import seed_sweep
from hitl_jax.console.cli import run_main
from hitl_jax.results.folder import ResultsFolder

_TESTS = pathlib.Path(__file__).parents[1]
_KEPT = _TESTS.parent / "results" / "ten_seeds"
_ENVIRONMENT = os.environ | {
    "PYTHONPATH": os.pathsep.join([str(_TESTS / "without_box2d"), str(_TESTS.parent)])
}
_SWEEP = (
    *("sweep", "--seeds", "1", "--methods", "srl", "--episodes", "1", "--test-episodes", "1"),
    *("--warmup-steps", "100", *small.OPTIONS),
)
_NOTE = "Box2D cannot be imported (No module named 'Box2D'"

# One process for many command lines: it imports JAX once.
_COMMANDS = """
import contextlib, io, json, sys
from hitl_jax.__main__ import main
told = []
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words)
    told.append([code, out.getvalue(), err.getvalue()])
print(json.dumps(told))
"""


def _run(*command):
    return subprocess.run(
        [sys.executable, *command], env=_ENVIRONMENT, capture_output=True, text=True
    )


def _outcomes(lines):
    """Exit code, stdout and stderr of each command line."""
    done = _run("-c", _COMMANDS, json.dumps([list(map(str, line)) for line in lines]))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep with the default backend: its folder and its output."""
    out = tmp_path_factory.mktemp("without") / "results"
    done = _run("-m", "hitl_jax", *_SWEEP, "--out", out)
    assert done.returncode == 0, done.stderr
    return out, done.stdout


def _copied_as_made_on(backend, folder, tmp_path):
    """A copy of a folder whose config names another backend."""
    other = tmp_path / backend
    shutil.copytree(folder, other)
    of_config(other, lambda config: config.update({"backend": backend}))
    return other


@pytest.mark.slow
def test_a_sweep_uses_backend_jax_and_says_so(swept):
    out, said = swept
    first, *others = said.splitlines()
    assert first.startswith(_NOTE)
    assert first.endswith("): --backend jax")
    assert not any("Box2D" in line for line in others)
    folder = ResultsFolder(out)
    assert folder.load_config()["backend"] == "jax"
    (run,) = folder.load_all()
    assert run.info["config"]["backend"] == "jax"
    assert (len(run.episodes["return"]), len(run.tests["return"])) == (1, 1)


@pytest.mark.slow
def test_runs_of_backend_jax_are_replayed_and_resumed(swept):
    out, _ = swept
    (code, said, err), again = _outcomes(
        [("replay", out, "--method", "srl"), (*_SWEEP, "--out", out)]
    )
    assert code == 0, err
    assert "its return is the recorded one" in said
    assert again[0] == 0, again
    assert again[1].startswith(_NOTE)


@pytest.mark.slow
def test_a_folder_of_another_backend_is_not_resumed(swept, tmp_path):
    """A folder that was begun with Box2D is not resumed without it, nor the reverse."""
    lean = _copied_as_made_on("lean", swept[0], tmp_path)
    ((code, out, err),) = _outcomes([(*_SWEEP, "--out", lean)])
    assert (code, err.count("\n")) == (2, 1)
    assert out.startswith(_NOTE)
    assert 'backend: folder has "lean", asked for "jax"' in err


@pytest.mark.slow
@theirs.needs_box2d
def test_with_box2d_a_folder_of_backend_jax_is_not_resumed(swept, capsys):
    assert run_main("sweep", seed_sweep.main, [*_SWEEP[1:], "--out", str(swept[0])]) == 2
    assert 'backend: folder has "jax", asked for "lean"' in capsys.readouterr().err


def test_commands_that_need_box2d_say_so_in_one_line(tmp_path):
    lean, official = (_copied_as_made_on(name, _KEPT, tmp_path) for name in ("lean", "gymnasium"))
    new = ("--out", tmp_path / "new")
    lines = {
        "backend 'lean'": [
            (*_SWEEP, *new, "--backend", "lean"),
            ("ablation", "fading", *new),
            ("tuning", *new),
            ("faults", *new),
            ("agreement", "--only", "scripted"),
        ],
        "backend 'gymnasium'": [
            (*_SWEEP, *new, "--backend", "gymnasium"),
            ("agreement", "--only", "step"),
        ],
        "made with --backend lean: backend 'lean'": [
            ("verify", lean),
            ("alarms", lean),
            ("replay", lean, "--method", "srl"),
        ],
        "made with --backend gymnasium: backend 'lean'": [("verify", official)],
        "the live walker": [("live", "--journal", tmp_path / "session.jsonl", "--port", "0")],
        "--only pool": [("benchmark", "--only", "pool")],
        "--only loop": [("benchmark", "--only", "learner", "loop")],
    }
    every = [(what, line) for what, some in lines.items() for line in some]
    for (what, line), (code, out, err) in zip(
        every, _outcomes([line for _, line in every]), strict=True
    ):
        assert (code, err.count("\n")) == (2, 1), (line, err)
        assert err.startswith("error: "), line
        assert f"{what} needs Box2D (No module named 'Box2D'" in err, line
        assert err.endswith('): pip install "gymnasium[box2d]"\n'), line
        assert "Traceback" not in out
    assert not (tmp_path / "new" / "config.json").exists()
    assert not (tmp_path / "session.jsonl").exists()


def test_pools_say_so_too():
    code = (
        "from hitl_jax.envs import HARDCORE_WALKER, WALKER, default_backend, make_pool\n"
        "assert default_backend() == 'jax'\n"
        "for backend in ('lean', 'gymnasium'):\n"
        "    for env_id in (WALKER, HARDCORE_WALKER):\n"
        "        try:\n"
        "            make_pool(backend, 1, env_id=env_id)\n"
        "        except ImportError as error:\n"
        "            assert f'backend {backend!r} needs Box2D' in str(error), error\n"
        "        else:\n"
        "            raise AssertionError(backend)\n"
        "make_pool('gymnasium', 1, env_id='Pendulum-v1').close()\n"
    )
    done = _run("-c", code)
    assert done.returncode == 0, done.stderr
