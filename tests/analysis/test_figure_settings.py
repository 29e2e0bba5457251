"""The user's own settings change no figure."""

import os
import subprocess
import sys

import matplotlib
import matplotlib.style
import pytest
from example_figures import NAMES

from hitl_jax.analysis.figures import draw_all

_SETTINGS = {
    "text.usetex": True,
    "font.family": "serif",
    "lines.linewidth": 9.0,
    "axes.grid": False,
    "savefig.bbox": "tight",
    "savefig.transparent": True,
    "svg.fonttype": "none",
    "path.simplify": False,
    "axes.formatter.use_locale": True,
}


_ENVIRONMENTS = (
    {"MPLBACKEND": "module://matplotlib_inline.backend_inline"},
    {"MPLBACKEND": "nonsense"},
    {"MPLBACKEND": "pgf"},
    {"MPLCONFIGDIR": "/proc/nowhere", "HOME": "/proc/nowhere"},
)


def _pictures(folder):
    return {path.name: path.read_bytes() for path in sorted((folder.path / "figures").iterdir())}


@pytest.mark.parametrize("theirs", ["text.usetex", "dark_background", "all"])
def test_settings_of_the_users_process_change_no_figure(plain, theirs):
    before = _pictures(plain)
    with matplotlib.rc_context():
        if theirs in matplotlib.style.available:
            matplotlib.style.use(theirs)
        else:
            matplotlib.rcParams.update(
                _SETTINGS if theirs == "all" else {theirs: _SETTINGS[theirs]}
            )
        kept = dict(matplotlib.rcParams)
        assert draw_all(plain).failures == []
        assert dict(matplotlib.rcParams) == kept
    assert _pictures(plain) == before


@pytest.mark.slow
@pytest.mark.parametrize("environment", _ENVIRONMENTS)
def test_settings_of_the_users_machine_change_no_figure(plain, environment, tmp_path):
    before = _pictures(plain)
    for path in plain.path.glob("figures/*"):
        path.unlink()
    theirs = "".join(f"{name}: {value}\n" for name, value in _SETTINGS.items())
    (tmp_path / "matplotlibrc").write_text(f"backend: nonsense\nnonsense.key: 1\n{theirs}")
    done = subprocess.run(
        [sys.executable, "-m", "hitl_jax", "figures", str(plain.path)],
        cwd=tmp_path,
        env=os.environ | environment | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert _pictures(plain) == before


def test_a_matplotlibrc_that_is_no_text_is_one_line(plain, tmp_path):
    (tmp_path / "matplotlibrc").write_bytes(b"font.family: caf\xe9\n")
    done = subprocess.run(
        [sys.executable, "-m", "hitl_jax", "figures", str(plain.path)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])},
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    [line] = done.stdout.splitlines()
    assert line.startswith(", ".join(NAMES) + ": could not be drawn: UnicodeDecodeError: ")


@pytest.mark.parametrize(("backend", "after"), [("svg", "svg"), ("nonsense", None)])
def test_the_users_backend_stays_theirs(backend, after):
    code = (
        "import os\nfrom hitl_jax.analysis.figure_style import import_matplotlib, panels, style\n"
        "with style(): panels(1, 1, (1.0, 1.0))\n"
        "print(import_matplotlib().get_backend(auto_select=False), os.environ['MPLBACKEND'])"
    )
    environment = os.environ | {"MPLBACKEND": backend}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        encoding="utf-8",
        check=True,
    )
    assert done.stdout == f"{after} {backend}\n"


def test_help_needs_no_matplotlib():
    code = (
        "import importlib, sys\nfrom hitl_jax.__main__ import _COMMANDS\n"
        "for module, _ in _COMMANDS.values():\n"
        "    importlib.import_module(f'hitl_jax.commands.{module}')\n"
        "assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
