"""Figures from whatever is there: full results, early ones, one seed, nothing."""

import os
import subprocess
import sys
import xml.etree.ElementTree
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
import pytest
from example_training import make_training
from matplotlib.figure import Figure

from hitl_jax.analysis import alarm_figures, figure_data, figures
from hitl_jax.analysis.figures import draw_all
from hitl_jax.benchmarks import scaling
from hitl_jax.commands import figures as command
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.results import atomic_files
from hitl_jax.results.episode_tables import METHODS, PROGRESS_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.studies.ablations import figure
from hitl_jax.studies.ablations.options import AblationOptions
from hitl_jax.studies.ablations.runs import runs_of, settings_of
from hitl_jax.studies.ablations.settings import ABLATIONS
from hitl_jax.studies.ablations.store import _MEASURES, Store
from hitl_jax.studies.ablations.write import write_ablation
from hitl_jax.sweep.background_figures import draw

CONFIG = {
    "agent": {"indicator": "hull_angle", "boundary_source": "rule"},
    "hyper": {"initial_boundary": 0.7, "delta_minus": 1e-3, "delta_plus": 1e-3},
}
INFO = {"config": CONFIG, "versions": {}, "commit": None, "updates": 1}
NAMES = (
    "figure4_training",
    "figure4_steps",
    "figure5_test",
    "figure5_progress",
    "figure6_boundary",
    "figure6_moves",
    "figure7_human",
)


def make_tests(method: str, modes: tuple[str, ...] = ("autonomous", "assisted")) -> dict[str, Any]:
    mode = [mode for mode in modes for _ in range(5)]
    columns = dict.fromkeys(TEST_COLUMNS, np.zeros(len(mode))) | {"end": ["goal"] * len(mode)}
    return columns | {"mode": mode, "return": 200.0 + 10.0 * np.arange(len(mode))}


def save(
    folder: ResultsFolder, method: str, seed: int, diverged: int | None = None, **modes: Any
) -> None:
    info = INFO | {"wall_seconds": 1.0, "env_steps": 1}
    if diverged is not None:
        info |= {"diverged": {"quantity": "action", "env_steps": 1, "episodes": diverged}}
    tests = make_tests(method, **modes)
    progress = {name: tests[name] for name in PROGRESS_COLUMNS[1:]}
    progress["trained"] = [50 if mode == "autonomous" else 100 for mode in tests["mode"]]
    folder.save_run(RunKey(method, seed), make_training(method, seed), tests, {}, info, progress)


def text_of(figure) -> str:
    legends = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    labels = [f"{axes.get_xlabel()} {axes.get_ylabel()}" for axes in figure.axes]
    return "\n".join(legends + labels)


@pytest.fixture
def folder(tmp_path):
    folder = ResultsFolder(tmp_path / "out")
    folder.create_or_resume(CONFIG, "command")
    return folder


@pytest.fixture
def drawn(monkeypatch) -> dict[str, Any]:
    """The figures by name, kept instead of written."""
    kept: dict[str, Any] = {}

    def keep(figure, stem):
        figure.draw_without_rendering()
        kept[stem.name] = figure
        return [stem]

    monkeypatch.setattr(figures, "save", keep)
    return kept


def test_full_results_give_every_figure_twice(folder):
    for method in METHODS:
        for seed in range(3):
            save(folder, method, seed)
    before = dict(matplotlib.rcParams)
    paths, notes, failures = draw_all(folder)
    assert dict(matplotlib.rcParams) == before
    assert notes == failures == []
    written = sorted(p.name for p in (folder.path / "figures").iterdir())
    assert written == sorted(f"{name}.{kind}" for name in NAMES for kind in ("png", "svg"))
    assert sorted(p.name for p in paths) == written
    for path in paths:
        if path.suffix == ".svg":
            assert xml.etree.ElementTree.parse(path).getroot().tag.endswith("svg")
        else:
            data = path.read_bytes()
            assert data.startswith(b"\x89PNG")
            # The header's width: a paper's column of 3.5 inches at 150 dots and more.
            assert int.from_bytes(data[16:20]) >= 3.5 * 150


def test_early_results_draw_what_there_is(folder, drawn):
    for seed, count in ((0, 30), (1, 12)):
        folder.write_partial(RunKey("hitl-ac", seed), make_training("hitl-ac", seed, count))
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0, 2))
    folder.write_partial(RunKey("srl", 1), make_training("srl", 1, 0))
    _, notes, _ = draw_all(folder)
    assert [note.split(":")[0] for note in notes] == ["figure5_test", "figure5_progress"]
    text = text_of(drawn["figure4_training"])
    assert "HITL-AC (2 seeds, 1 at the end, 2 unfinished)" in text
    assert "SRL (no band: one seed, 1 unfinished)" in text
    assert "(mean of the last 20 episodes)" in text
    lines = drawn["figure4_training"].axes[0].get_lines()
    # Two seeds of episodes 1 to 30 and 1 to 12: half of them reach the end.
    assert lines[1].get_xdata()[-1] == 30
    # A bar stands at the last episode that both have.
    assert (lines[1].get_marker(), lines[1].get_markevery()) == ("|", [11])
    [title] = [of.get_title().get_text() for of in drawn["figure4_training"].legends]
    assert "right of the bar on a curve: over the seeds that got so far" in title
    assert "before episode 20: means of the episodes so far" in title
    assert lines[0].get_color() == "#D55E00"
    assert "SRL" not in text_of(drawn["figure6_boundary"])


def test_one_finished_run_of_one_method(folder, drawn):
    save(folder, "srl", 0, modes=("autonomous",))
    _, notes, _ = draw_all(folder)
    without_human = {"figure6_boundary", "figure6_moves", "figure7_human"}
    assert {note.split(":")[0] for note in notes} == without_human
    for axes in drawn["figure5_test"].axes:
        assert [tick.get_text() for tick in axes.get_xticklabels()] == [
            "SRL\n(no interval: one seed)"
        ]


@pytest.mark.parametrize("modes", [(), ("assisted",)])
def test_runs_without_autonomous_tests_skip_figure_5(folder, drawn, modes):
    save(folder, "hitl-ac", 0, modes=modes)
    _, notes, _ = draw_all(folder)
    assert [note.split(":")[0] for note in notes] == ["figure5_test", "figure5_progress"]


def test_figure_5_shows_the_means_of_the_tests(folder, drawn):
    save(folder, "hitl-ac", 0)
    draw_all(folder)
    left, right = drawn["figure5_test"].axes
    for dots, returns in zip(left.get_lines(), (200.0, 250.0), strict=False):
        np.testing.assert_array_equal(dots.get_ydata(), returns + 10.0 * np.arange(5))
        assert dots.get_linestyle() == "None"  # Test episodes are independent of each other.
    heights = [line.get_ydata()[0] for line in right.get_lines()[:4]]
    # Autonomous 200 … 240, assisted 250 … 290: the seed's dot, then the mean over the one seed.
    assert heights == [220.0, 220.0, 270.0, 270.0]


def test_what_moved_the_boundary_adds_up(tmp_path, drawn):
    folder = ResultsFolder(tmp_path / "residual")
    agent = {"indicator": "hull_angle", "boundary_source": "residual"}
    hyper = {"initial_boundary": 0.6, "delta_minus": 0.01, "delta_plus": 0.02}
    folder.create_or_resume({"agent": agent, "hyper": hyper}, "command")
    training = make_training("hitl-ac", 0, 5)
    training |= {"true_alarms": np.arange(5), "false_alarms": np.array([0, 2, 0, 0, 1])}
    folder.write_partial(RunKey("hitl-ac", 0), training)
    draw_all(folder)
    whole, down, up, rest = (line.get_ydata() for line in drawn["figure6_moves"].axes[0].lines)
    np.testing.assert_allclose(whole, 0.1)  # from 0.6 to the 0.7 of every episode
    np.testing.assert_allclose(down, [0.0, -0.01, -0.03, -0.06, -0.1])
    np.testing.assert_allclose(up, [0.0, 0.04, 0.04, 0.04, 0.06])
    np.testing.assert_allclose(whole, down + up + rest)


def _with_threshold(tmp_path, danger):
    folder = ResultsFolder(tmp_path / danger)
    agent = CONFIG["agent"] | {"danger": danger}
    hyper = CONFIG["hyper"] | {"human": {"tolerance": 0.45}}
    folder.create_or_resume(CONFIG | {"agent": agent, "hyper": hyper}, "command")
    folder.write_partial(RunKey("hitl-ac", 0), make_training("hitl-ac", 0))
    return folder


def test_figure_6_has_the_humans_threshold(tmp_path, drawn):
    draw_all(_with_threshold(tmp_path, "threshold"))
    upper = drawn["figure6_boundary"].axes[0]
    assert any(list(line.get_ydata()) == [0.45, 0.45] for line in upper.get_lines())
    assert "the human's threshold, 0.45 rad" in text_of(drawn["figure6_boundary"])
    draw_all(_with_threshold(tmp_path, "lookahead"))
    assert "threshold" not in text_of(drawn["figure6_boundary"])


def test_the_solved_line_is_always_in_view(folder, drawn):
    folder.write_partial(RunKey("hitl-fix", 0), make_training("hitl-fix", 0, 3))
    draw_all(folder)
    for name in ("figure4_training", "figure4_steps", "figure6_boundary", "figure7_human"):
        low, high = drawn[name].axes[-1].get_ylim()
        assert low < -90.0
        assert high > 300.0


def test_another_indicator_is_not_called_radians(tmp_path, drawn):
    folder = ResultsFolder(tmp_path / "other")
    folder.create_or_resume({"agent": {"indicator": "hull_velocity"}}, "command")
    folder.write_partial(RunKey("hitl-ac", 0), make_training("hitl-ac", 0, 3))
    draw_all(folder)
    assert "boundary [unit of hull_velocity]" in text_of(drawn["figure6_boundary"])


def test_the_same_data_give_the_same_files(folder):
    folder.write_partial(RunKey("hitl-ac", 0), make_training("hitl-ac", 0, 5))
    first, second = ([p.read_bytes() for p in draw_all(folder).paths] for _ in range(2))
    assert first == second


def test_command_prints_the_files(folder, capsys):
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0, 5))
    assert run_main("figures", command.main, [str(folder.path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert str(folder.path / "figures/figure4_training.png") in lines
    assert "figure5_test: no data for it" in lines


def test_command_refuses_in_one_line(folder, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for path, says in (
        (tmp_path / "nowhere", "no results here (no config.json)"),
        (tmp_path / "empty", "no results here (no config.json)"),
        (folder.path, "no episode has been saved yet"),
    ):
        assert run_main("figures", command.main, [str(path)]) == 2
        captured = capsys.readouterr()
        assert captured.err == f"error: {path}: {says}\n"
        assert captured.out == ""


def test_command_runs_as_a_module(folder):
    arguments = [sys.executable, "-m", "hitl_jax", "figures", str(folder.path)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == f"error: {folder.path}: no episode has been saved yet\n"


def test_a_diverged_run_counts_in_returns_and_nowhere_else(folder):
    for seed in range(3):
        save(folder, "hitl-ac", seed)
    save(folder, "hitl-ac", 3, diverged=10)
    save(folder, "hitl-fix", 0, diverged=0)
    [fixed, learned] = figure_data.load(folder).methods
    assert [len(t["episode"]) for t in learned.training] == [40] * 4
    assert [len(t["episode"]) for t in learned.played] == [40, 40, 40, 10]
    assert len(fixed.training) == 1
    assert fixed.played == []
    paths, notes, failures = draw_all(folder)
    assert notes == failures == []
    assert len(paths) == 2 * len(NAMES)


# ------------------------------------------------------------------- the user's own settings

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


def _draw(folder):
    """As the command does."""
    return draw_all(folder)


@pytest.fixture
def plain(folder):
    """A folder with the two figures that it has data for, drawn without any settings."""
    folder.write_partial(RunKey("srl", 0), make_training("srl", 0))
    drawn = _draw(folder)
    assert len(drawn.paths) == 4 and drawn.failures == []
    return folder


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
        assert _draw(plain).failures == []
        assert dict(matplotlib.rcParams) == kept
    assert _pictures(plain) == before


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


# ------------------------------------------------------------- figures that cannot be drawn


def _fails(*_, **__):
    raise RuntimeError("there is\nno font")


def test_a_figure_that_cannot_be_drawn_costs_no_other(plain, monkeypatch, capsys):
    for path in plain.path.glob("figures/*"):
        path.unlink()
    monkeypatch.setitem(figures.DRAWINGS, "figure4_training", _fails)
    assert run_main("figures", command.main, [str(plain.path)]) == 1
    told = capsys.readouterr().out.splitlines()
    assert told[-1] == "figure4_training: could not be drawn: RuntimeError: there is no font"
    assert {path.stem for path in plain.path.glob("figures/*")} == {"figure4_steps"}
    [*_, told] = draw(plain)
    assert "figure4_training: could not be drawn" in told
    assert (plain.path / "summary.md").exists()


@pytest.mark.parametrize("error", [MemoryError("much"), ValueError("x"), OSError(2, "no font")])
def test_a_picture_that_cannot_be_made_is_told(plain, error, monkeypatch):
    real = Figure.savefig

    def savefig(figure, *arguments, **options):
        if options["format"] == "svg":
            raise error
        real(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    drawn = draw_all(plain)
    assert drawn.paths == []
    assert [line.split(":")[0] for line in drawn.failures] == ["figure4_training", "figure4_steps"]
    assert type(error).__name__ in drawn.failures[0]


def test_without_matplotlib_there_is_one_line(plain, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    [told] = draw_all(plain).failures
    assert told.startswith(", ".join(NAMES) + ": could not be drawn: ModuleNotFoundError: ")


def test_a_full_disk_is_the_folders_error(plain, monkeypatch):
    def full(descriptor, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic_files, "write_synced", full)
    with pytest.raises(ResultsError, match=r"figure4_training\.png: No space left on device"):
        draw_all(plain)


def test_the_other_drawings_cost_nothing_either(tmp_path, monkeypatch):
    """Of an ablation, of the benchmark, of alarms."""
    monkeypatch.setattr(figure, "draw_rows", _fails)
    options = AblationOptions(name="methods", seeds=1)
    store = Store(tmp_path / "runs.csv")
    setting, parts = next(settings_of(ABLATIONS["methods"]))
    [run, *_] = runs_of(setting, parts, options)
    store.add(run, dict.fromkeys(_MEASURES, 1.0) | {"commit": "abc"})
    written = write_ablation("methods", options, store)
    assert written.table
    assert written.failures == ["methods: could not be drawn: RuntimeError: there is no font"]
    assert (tmp_path / "methods.md").exists()
    monkeypatch.setattr(scaling, "draw_rows", _fails)
    [told] = scaling.draw_scaling([], str(tmp_path / "scaling.svg"))
    assert "scaling.svg: could not be drawn: " in told
    monkeypatch.setattr(alarm_figures, "_figure", _fails)
    (tmp_path / alarm_figures.DATA).write_text(",".join(alarm_figures.COLUMNS) + "\n")
    [told] = alarm_figures.draw(ResultsFolder(tmp_path)).failures
    assert told == "figure8_alarms: could not be drawn: RuntimeError: there is no font"
