"""A comparison of the three methods as a section of the report."""

import pathlib
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hitl_jax.analysis import alarm_figures, warning_figures
from hitl_jax.analysis.claims import judge
from hitl_jax.analysis.figure_data import tolerance_in
from hitl_jax.analysis.figures import draw_all
from hitl_jax.analysis.markdown import table
from hitl_jax.analysis.summary import write_summary
from hitl_jax.analysis.verdicts import Claim
from hitl_jax.config import Hyper
from hitl_jax.playback.load_trained import section_of
from hitl_jax.results.folder import ResultsFolder, Run
from hitl_jax.results.provenance import short_commit

_FIRST = "figure4_training"
_FIGURES = {
    _FIRST: "training return over episodes",
    "figure4_steps": "the same over environment steps",
    "figure5_test": "test episodes",
    "figure5_progress": "tests during training",
    "figure5_human_time": "tests over human time",
    "figure6_boundary": "the boundary",
    "figure6_moves": "what moved it",
    "figure7_human": "the human's work",
    "figure8_alarms": "alarms at any boundary",
}


class Compared(NamedTuple):
    """A comparison of the three methods.

    Attributes:
        options: with which options, in Markdown.
        folder: its name among the results.
    """

    options: str
    folder: str


class Section(NamedTuple):
    """What the report says of it.

    Attributes:
        compared: the comparison.
        text: the section.
        claims: verdicts; none where it has not been run, or has too few seeds.
    """

    compared: Compared
    text: str
    claims: Sequence[Claim] = ()


def in_brief(sections: Sequence[Section]) -> str:
    """What holds in the first comparison that is judged, by which numbers, and its figure."""
    judged = [section for section in sections if section.claims]
    if not judged:
        return ""
    first = judged[0]
    rows = [["claim", "the paper", "here", "verdict"]]
    rows += [
        [claim.name, claim.paper, claim.brief or claim.measured, f"**{claim.verdict}**"]
        for claim in first.claims
        if claim.verdict != "–"
    ]
    picture = f"![training return over episodes]({first.compared.folder}/figures/{_FIRST}.png)\n"
    shown = f"\n{picture}" if picture in first.text else ""
    seeds = first.claims[0].seeds
    title = f"## In brief: {first.compared.options}, {seeds} seeds of each method\n"
    return f"{title}\n{table(rows)}{shown}"


def at_a_glance(sections: Sequence[Section]) -> str:
    """The verdicts of all comparisons, a line for each claim; empty with fewer than two."""
    judged = [section for section in sections if section.claims]
    if len(judged) < 2:
        return ""
    verdicts = [{claim.name: claim for claim in section.claims} for section in judged]
    papers = {claim.name: claim.paper for section in judged for claim in section.claims}
    heads = (f"{one.compared.options} ({one.claims[0].seeds} seeds)" for one in judged)
    rows = [["claim", "the paper", *heads]]
    for name, paper in papers.items():
        told = [of[name].verdict if name in of else "not asked" for of in verdicts]
        if set(told) - {"–", "not asked"}:
            rows.append([name, paper, *told])
    return f"## With other options\n\n{table(rows)}"


def compare(comparison: Compared, root: pathlib.Path, say: Callable[[str], None]) -> Section:
    """Judges a comparison; writes its tables and draws its figures anew.

    Args:
        comparison: which.
        root: the folder of results.
        say: is told which figures could not be drawn, and why.

    Raises:
        ResultsError: if its folder is damaged or cannot be written.
    """
    folder = ResultsFolder(root / comparison.folder)
    title = f"## The three methods with {comparison.options}\n"
    if not folder.path.exists():
        return Section(comparison, f"{title}\nNot run yet.\n")
    write_summary(folder)
    failures = draw_all(folder).failures
    if (folder.path / alarm_figures.DATA).exists():
        failures += alarm_figures.draw(folder).failures
    if (folder.path / warning_figures.WARNINGS).exists():
        failures += warning_figures.draw(folder).failures
    for failure in failures:
        say(failure)
    runs: dict[str, list[Run]] = {}
    for run in folder.load_all():
        runs.setdefault(run.key.method, []).append(run)
    config = folder.load_config()
    seeds = ", ".join(f"{method} {len(of)}" for method, of in runs.items())
    commits = Counter(short_commit(run.info["commit"]) for of in runs.values() for run in of)
    made = ", ".join(f"{commit} ({count} runs)" for commit, count in commits.items())
    hyper = section_of(folder, "hyper", Hyper)
    try:
        bounds = (hyper.boundary_low, hyper.boundary_high)
        claims = judge(runs, tolerance_in(folder), bounds)
    except ValueError as error:
        return Section(comparison, f"{title}\nUnder way: {error}.\n")
    steps = sum(run.info["env_steps"] for of in runs.values() for run in of) / 1e6
    machines = Counter(
        run.info.get("machine", "not recorded") for of in runs.values() for run in of
    )
    where = ", ".join(f"{machine} ({count} runs)" for machine, count in machines.items())
    lost = [str(run.key) for of in runs.values() for run in of if run.diverged]
    diverged = f"Diverged, counted as falling at once from there on: {', '.join(lost)}.\n\n"
    name = comparison.folder
    figures = "".join(
        f"![{text}]({name}/figures/{stem}.png)\n"
        for stem, text in _FIGURES.items()
        if (folder.path / "figures" / f"{stem}.png").exists()
    )
    text = (
        f"{title}\nSeeds: {seeds}; {config['episodes']} training episodes and "
        f"{config['test_episodes']} test episodes each, {steps:.1f} million environment steps of "
        f"training. Commit {made}; machine: {where}. Options and versions of every run "
        f"are in `{name}`, its tables in [{name}/summary.md]({name}/summary.md).\n\n"
        f"{diverged if lost else ''}{_table_of(claims)}\n{figures}"
    )
    return Section(comparison, text, claims)


def _table_of(claims: Sequence[Claim]) -> str:
    """Claims as a table."""
    rows = [["claim", "the paper", "to hold", "measured", "seeds", "verdict"]]
    rows += [[c.name, c.paper, c.aim, c.measured, str(c.seeds), f"**{c.verdict}**"] for c in claims]
    return table(rows)
