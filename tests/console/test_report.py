"""The report: its verdicts, and that what is committed is what the data give."""

import pathlib
import shutil

import pytest

from hitl_jax.analysis.figure_style import Drawn
from hitl_jax.analysis.verdicts import HOLDS, HOLDS_NOT, UNDECIDED, Claim
from hitl_jax.commands import report
from hitl_jax.console.cli import run_main
from hitl_jax.errors import ResultsError
from hitl_jax.reports import comparison
from hitl_jax.reports import report as reports
from hitl_jax.reports.cost import cost_of_choices
from hitl_jax.studies.ablations.store import Store

_RESULTS = pathlib.Path(__file__).parents[2] / "results"


@pytest.mark.slow
def test_what_is_committed_is_what_the_data_give(tmp_path, monkeypatch):
    # Drawings may differ with matplotlib's version; texts may not.
    for module in (comparison, reports):
        monkeypatch.setattr(module, "draw_all", lambda folder: Drawn([], [], []))
    copy = tmp_path / "results"
    shutil.copytree(_RESULTS, copy)
    assert run_main("report", report.main, ["--results", str(copy)]) == 0
    for path in sorted(_RESULTS.rglob("*.md")):
        written = copy / path.relative_to(_RESULTS)
        assert written.read_text() == path.read_text()


@pytest.mark.parametrize("folder", ["missing", "pyproject.toml"])
def test_a_folder_without_results_is_refused(folder, capsys):
    assert run_main("report", report.main, ["--results", folder]) == 2
    assert capsys.readouterr().err == f"error: --results {folder}: holds no results\n"


def test_other_options_have_a_line_for_each_claim_that_is_judged_somewhere():
    def section(options, seeds, verdicts):
        claims = [Claim(name, "–", "", "", verdict, seeds) for name, verdict in verdicts.items()]
        return comparison.Section(comparison.Compared(options, "mine"), "", claims)

    told = comparison.at_a_glance(
        [
            section("the defaults", 30, {"speed": HOLDS, "power": "–"}),
            section("others", 5, {"speed": HOLDS_NOT, "power": "–", "help": UNDECIDED}),
            comparison.Section(comparison.Compared("not run", "none"), "Not run yet."),
        ]
    )
    table = [line.strip("|").split(" | ") for line in told.splitlines() if line.startswith("|")]
    head, _, *rows = [[cell.strip() for cell in line] for line in table]
    assert head == ["claim", "the paper", "the defaults (30 seeds)", "others (5 seeds)"]
    assert rows == [["speed", "–", HOLDS, HOLDS_NOT], ["help", "–", "not asked", UNDECIDED]]
    assert comparison.at_a_glance([]) == ""


@pytest.mark.parametrize(
    "shown", ["", "![training return over episodes](mine/figures/figure4_training.png)\n"]
)
def test_in_brief_the_first_judged_comparison_has_its_numbers(shown):
    claims = [
        Claim("speed", "fast", "", "100 [90, 110] and more", HOLDS, 7, brief="100 [90, 110]"),
        Claim("skill", "–", "", "9", UNDECIDED, 7),
        Claim("power", "–", "", "50", "–", 7),
    ]
    told = comparison.in_brief(
        [
            comparison.Section(comparison.Compared("not run", "none"), "Not run yet."),
            comparison.Section(comparison.Compared("the defaults", "mine"), shown, claims),
        ]
    )
    assert told.startswith("## In brief: the defaults, 7 seeds of each method\n")
    rows = [line for line in told.splitlines() if line.startswith("|")][2:]
    assert rows == [
        "| speed | fast | 100 [90, 110] | **holds** |",
        "| skill | – | 9 | **not decided** |",
    ]
    assert ("(mine/figures/figure4_training.png)" in told) == bool(shown)
    assert comparison.in_brief([]) == ""


def test_each_kept_run_on_seeds_of_tuning_counts_once_in_the_cost():
    told = cost_of_choices(_RESULTS).splitlines()
    lines = [line.split(" | ") for line in told if line.startswith("|")][2:]
    assert lines[0][:3] == ["| learner", "100 to 104", "45"]
    kept = Store(_RESULTS / "ablations" / "runs.csv").keys()
    assert sum(int(line[2]) for line in lines[1:]) == sum(run.seed >= 100 for run in kept)


def test_a_scope_that_is_no_text_is_refused_before_any_work(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "config.json").write_text("{}")
    (tmp_path / "scope.md").write_bytes(b"\xff")
    with pytest.raises(ResultsError, match=r"scope\.md: damaged"):
        reports.write_report(tmp_path, say=print)


def test_where_nothing_was_tuned_no_cost_is_told(tmp_path):
    assert cost_of_choices(tmp_path) == ""
