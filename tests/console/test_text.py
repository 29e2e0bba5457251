"""A user's own words: shown as they are, on any terminal, in figures and tables; files in UTF-8."""

import ast
import contextlib
import dataclasses
import io
import json
import os
import pathlib
import subprocess
import sys
import xml.etree.ElementTree

import pytest
from example_training import make_training
from matplotlib.figure import Figure

import hitl_jax
from hitl_jax.analysis import markdown
from hitl_jax.analysis.figure_style import literal, style
from hitl_jax.config import AgentConfig, Hyper
from hitl_jax.console.cli import BadInput, parse
from hitl_jax.console.output import print_rows, replace_what_cannot_be_encoded
from hitl_jax.console.progress import Progress
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.studies.ablations import table
from hitl_jax.studies.tuning import table as tuning_table
from hitl_jax.studies.tuning.options import TuningOptions
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.training.run_spec import LoopConfig

_NAMES = (
    *("runs/[lr=0.1] x", "runs/[/data]", "runs/[bold red]", "runs/:smile:", r"runs/\[x]"),
    *("[link=http://a.b]c", "[", "runs/[@click=x]", "100%", "{x}"),
)
_ENCODINGS = (
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1:strict"},
    {"PYTHONIOENCODING": "ascii:surrogateescape"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
)


# -------------------------------------------------------------------------------- terminals


@pytest.mark.parametrize("name", _NAMES)
def test_lines_and_tables_show_names_as_they_are(name, capsys):
    Progress(["srl"], 1, 10, 0).say(f"results: {name}")
    assert capsys.readouterr().out == f"results: {name}\n"
    print_rows(name, [{name: name}])
    assert capsys.readouterr().out.count(name) == 3  # Title, head and cell.


@pytest.mark.parametrize("name", _NAMES)
def test_a_line_above_the_table_of_a_terminal_shows_names_as_they_are(name, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")  # Which rich takes for a terminal.
    terminal = io.StringIO()
    with contextlib.redirect_stdout(terminal), Progress([name], 1, 10, 0) as shown:
        shown.say(f"results: {name}")
        shown.show([])
    assert f"results: {name}\n" in terminal.getvalue()
    assert f"\n{name} " in terminal.getvalue()


@pytest.mark.parametrize("name", [*_NAMES, "two  spaces", "x" * 150, "│ ── │", "ü"])
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_bad_value_is_told_as_it_is(name, encoding, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    terminal = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    with contextlib.redirect_stdout(terminal), pytest.raises(BadInput) as caught:
        parse(SweepOptions, ["--seeds", name])
    assert str(caught.value) == f"--seeds {name}: must be a whole number"
    assert os.environ["COLUMNS"] == "40"


def _command(*words, **environment):
    done = subprocess.run(
        [sys.executable, "-m", "hitl_jax", *words],
        env=os.environ | environment,
        capture_output=True,
        check=False,
    )
    assert b"Traceback" not in done.stderr
    return done


@pytest.mark.parametrize(
    "environment",
    [_ENCODINGS[0], *(pytest.param(one, marks=pytest.mark.slow) for one in _ENCODINGS[1:])],
)
def test_help_and_refusals_on_any_terminal(environment):
    assert b"usage: hitl-jax COMMAND" in _command("--help", **environment).stdout
    done = _command("sweep", "--help", **environment)
    assert done.returncode == 0
    assert b"--human.tolerance" in done.stdout
    for words in (("ünknown",), ("sweep", "--seeds", "τ"), ("figures", "nowhere/ü"), (b"\xff",)):
        done = _command(*words, **environment)
        assert done.returncode == 2
        assert done.stderr.startswith(b"error: ")
        assert done.stderr.count(b"\n") == 1


@pytest.mark.parametrize(
    ("environment", "name"),
    [(_ENCODINGS[0], "τ"), (_ENCODINGS[1], b"no \xff text"), (_ENCODINGS[3], "τ")],
)
def test_figures_of_any_folder_on_any_terminal(environment, name, tmp_path):
    path = os.fsencode(tmp_path) + b"/" + (name if isinstance(name, bytes) else name.encode())
    folder = ResultsFolder(os.fsdecode(path))
    folder.create_or_resume({}, "command")
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0, 3))
    done = _command("figures", path, **environment)
    assert done.returncode == 0, done.stderr
    assert (folder.path / "figures/figure4_training.svg").exists()
    assert b"figures/figure4_training.svg\n" in done.stdout


def test_a_table_on_a_terminal_that_knows_little(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    replace_what_cannot_be_encoded()
    with Progress(["srl"], 1, 10, 0) as shown:
        shown.say("results: τ")
        shown.show([])
    print_rows("τ", [{"µs": "–"}])
    sys.stdout.flush()
    assert b"results: ?\n" in written.getvalue()
    assert b"\nsrl " in written.getvalue()


def test_a_stream_that_takes_no_orders_stays_as_it_is(monkeypatch):
    for stream in (None, io.StringIO(), object()):
        monkeypatch.setattr(sys, "stdout", stream)
        replace_what_cannot_be_encoded()
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="backslashreplace")
    monkeypatch.setattr(sys, "stdout", terminal)
    replace_what_cannot_be_encoded()
    assert terminal.errors == "backslashreplace"


# -------------------------------------------------------------------------- figures and tables


@pytest.mark.parametrize("name", ["$x$", "a $ b", r"$\frac{", "$$", r"\$5", "$x$ and $y", "^_{}"])
def test_figures_show_names_as_they_are(name):
    with style({"svg.fonttype": "none"}):
        figure = Figure()
        figure.subplots().set(xlabel=literal(name))
        picture = io.BytesIO()
        figure.savefig(picture, format="svg")
    drawn = xml.etree.ElementTree.fromstring(picture.getvalue())
    assert name in [element.text for element in drawn.iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.parametrize("name", ["a|b", "|", "two\nlines", r"a\b"])
def test_tables_keep_their_columns(name):
    shown = " ".join(name.split("\n")).replace("|", r"\|")
    assert markdown.table([["x", name], [name, "y"]]) == (
        f"| x | {shown} |\n| --- | --- |\n| {shown} | y |\n"
    )
    runs = [dict.fromkeys(measure for measure, _, _ in table._MEASURES) | {"diverged": 0}]
    lines = [table.Line(name, "srl", runs)]
    text = table.to_markdown("title", "budget", lines)
    assert f"\n| {shown} | srl | 1 |" in text


def test_a_configuration_of_any_name_is_a_line_of_the_tuning(tmp_path):
    options = TuningOptions(seeds=1)
    stage = {"ticks": 2, "seconds": 1.0, "srl": [1.0], "hitl-fix": [1.0], "hitl-ac": [1.0]}
    asked = {"budget": options.budget, "agent": dataclasses.asdict(AgentConfig())}
    asked |= {"loop": dataclasses.asdict(LoopConfig()), "hyper": dataclasses.asdict(Hyper())}
    done = {"asked": asked, "commit": None, "stages": [stage] * 3}
    done["tests"] = {method: [1.0] for method in METHODS}
    (tmp_path / "a|b – c.json").write_text(json.dumps(done), encoding="utf-8")
    assert (
        tuning_table.table(tmp_path, options).splitlines()[2].startswith(r"| a\|b – c | unknown |")
    )


# --------------------------------------------------------------------------------------- files


def test_no_file_is_read_or_written_in_the_locales_encoding():
    places = []
    for path in pathlib.Path(hitl_jax.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and not _names_an_encoding(node):
                places.append(f"{path.name}:{node.lineno}")
    assert places == []


def _names_an_encoding(call):
    """Of a call that opens a text; other calls have no need of one."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    given = {word.arg: word.value for word in call.keywords}
    if "encoding" in given:
        return True
    if name in ("read_text", "write_text", "NamedTemporaryFile"):
        return False
    if name == "open" and isinstance(call.func, ast.Name):
        mode = call.args[1] if len(call.args) > 1 else given.get("mode")
        return isinstance(mode, ast.Constant) and "b" in mode.value
    return not {"text", "universal_newlines"} & given.keys()


def test_what_is_no_character_is_written_as_a_question_mark(tmp_path):
    write_text_atomic(tmp_path / "text.md", "τ \udcff \ud800")
    assert (tmp_path / "text.md").read_bytes() == "τ ? ?".encode()


def test_a_command_that_is_no_text_can_be_read_again(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume({"gamma": 0.9}, "hitl-jax sweep --out \udcff τ")
    written = (folder.path / "config.json").read_bytes()
    assert json.loads(written.decode("ascii"))["command"].endswith("--out ? τ")
    assert folder.create_or_resume({"gamma": 0.9}, "again") == []
