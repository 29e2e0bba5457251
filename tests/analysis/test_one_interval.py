"""A number has the same interval wherever it stands."""

import pathlib
import re

import pytest

from hitl_jax.analysis import claims_on_skill, stats, summary
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.figure_data import load
from hitl_jax.analysis.skill_figures import tests as draw_tests
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.studies.ablations import table

_RESULTS = pathlib.Path(__file__).parents[2] / "results"
_FOLDERS = ("ten_seeds", "paper")


def _rows(text):
    """Cells of the lines of Markdown's tables, by the first cell; of several the first."""
    rows = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        rows.setdefault(cells[0], cells[1:])
    return rows


def _numbers(text):
    return [float(number) for number in re.findall(r"-?[0-9.]+", text)]


def _runs(folder):
    runs = {}
    for run in folder.load_all():
        runs.setdefault(run.key.method, []).append(run)
    return runs


@pytest.mark.parametrize("name", _FOLDERS)
def test_in_all_tables_and_figures(name):
    folder = ResultsFolder(_RESULTS / name)
    runs = _runs(folder)
    told = _rows((folder.path / "summary.md").read_text())
    means = _rows((folder.path / "summary.md").read_text().split("## Mean over seeds")[1])
    compared = ComparedRuns(runs, 0.45, (0.05, 1.5))
    skill = claims_on_skill.skill(compared).measured
    sure = claims_on_skill.improvement(compared).measured
    figure = draw_tests(load(folder))
    bars = [line for line in figure.axes[1].get_lines() if line.get_linewidth() == 1.4]
    assert len(bars) == 5  # Of SRL nobody assists.
    for place, method in enumerate(runs):
        centre, mean = (rows["autonomous test return"][place] for rows in (told, means))
        assert f"{method.upper()} {centre} (mean {mean})" in skill
        rows = [summary.summarise_run(run) for run in runs[method]]
        line = table.Line("any", method, rows)
        cell = _rows(table.to_markdown("title", "budget", [line]))["any"][3]
        assert _numbers(cell.split(";")[0]) == pytest.approx(_numbers(mean), abs=0.56)  # rounded
        interval = stats.bootstrap_interval(line.values("test_return_mean"), stats.mean)
        assert tuple(bars[2 * place - (place > 0)].get_ydata()) == interval
    for pair in ("hitl-ac over hitl-fix", "hitl-fix over srl"):
        x, y = pair.upper().split(" OVER ")
        assert f"{x} over {y} {told[pair][0]}" in sure


@pytest.mark.parametrize("name", _FOLDERS)
def test_in_the_committed_report_and_summary(name):
    told = _rows((_RESULTS / name / "summary.md").read_text())
    parts = re.split(r"^## ", (_RESULTS / "REPORT.md").read_text(), flags=re.MULTILINE)
    [report] = [part for part in parts if f"({name}/summary.md)" in part]
    cell = _rows(report)["How sure that order is"][2]
    assert f"HITL-FIX over SRL {told['hitl-fix over srl'][0]}" in cell
    assert f"HITL-AC over HITL-FIX {told['hitl-ac over hitl-fix'][0]}" in cell


@pytest.mark.parametrize("path", sorted(_RESULTS.glob("*/summary.md")), ids=lambda p: p.parent.name)
def test_in_the_page_about_the_folders(path):
    told, means = (
        _rows(part)["autonomous test return"]
        for part in path.read_text().split("## Interquartile mean over seeds")[1].split("## Mean")
    )
    parts = re.split(r"^## ", (_RESULTS / "README.md").read_text(), flags=re.MULTILINE)
    [page] = [part for part in parts if path.parent.name in part.splitlines()[0].split()]
    for label, cells in _rows(page).items():
        if label.startswith("autonomous test return, interquartile mean"):
            assert cells == told
        elif label.startswith("autonomous test return, mean"):
            assert cells == means
    if len(means) == 1:  # One method: its mean stands in the text.
        assert f"{_numbers(means[0])[0]:.0f}" in page
