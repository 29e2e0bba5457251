"""The report's section on walkers whose human foresees falls: warnings, boundary and help."""

import pathlib
from collections.abc import Callable, Collection

import numpy as np

from hitl_jax.analysis import assistance_figure, stats, warning_figures
from hitl_jax.analysis.assistance_figure import (
    BUDGETS,
    HUMANS,
    JUDGES,
    TRUSTS,
    help_at,
    interval,
    rules_of,
)
from hitl_jax.analysis.figures import draw_all
from hitl_jax.analysis.markdown import table
from hitl_jax.analysis.summary import summarise_run, write_summary
from hitl_jax.analysis.warning_figures import Rows, only, pooled_share
from hitl_jax.config import Method
from hitl_jax.results.episode_tables import select
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.provenance import short_commit
from hitl_jax.results.run_files import Run

FOLDERS = ("full", "foresight_ddpg", "foresight_120", "foresight_160")

_FALSE_ALARMS = 0.01
_METHOD = str(Method.HITL_AC)
_FIGURES = {
    "figure6_boundary": "the executed boundary",
    "figure11_early_warnings": "alarms before falls",
    "figure12_assistance": "help at equal human time",
}


def foresight(root: pathlib.Path, say: Callable[[str], None], shown: Collection[str] = ()) -> str:
    """The section, of each of `FOLDERS` that is there.

    Args:
        root: the folder of results.
        shown: folders whose summary and figures 4 to 7 another section has.
        say: is told which figures could not be drawn, and why.

    Raises:
        ResultsError: if results are damaged.
    """
    parts = ["## A human who foresees falls, and a boundary that π_θ gives\n"]
    for name in FOLDERS:
        if (root / name).exists():
            parts.append(_of(ResultsFolder(root / name), say, name in shown))
    return "\n".join(parts if len(parts) > 1 else [*parts, "Not run yet.\n"])


def _of(folder: ResultsFolder, say: Callable[[str], None], shown: bool) -> str:
    if lacks := [name for name in warning_figures.TABLES if not (folder.path / name).exists()]:
        return f"`{folder.path.name}`: under way, without {' and '.join(lacks)} so far.\n"
    helped = (folder.path / assistance_figure.DATA).exists()
    drawn, figures = warning_figures.draw(folder), list(_FIGURES)
    if shown:
        figures.remove("figure6_boundary")
    else:
        write_summary(folder)
        drawn = draw_all(folder).with_(drawn)
    if helped:
        drawn = drawn.with_(assistance_figure.draw(folder))
    for failure in drawn.failures:
        say(failure)
    runs = folder.load_all()
    commits = ", ".join(sorted({short_commit(run.info["commit"]) for run in runs}))
    learner = folder.load_config()["agent"]["learner"]
    episodes = folder.load_config()["episodes"]
    head = (
        f"### `--learner {learner}`, {episodes} episodes, {len(runs)} runs\n\n"
        f"`{folder.path.name}`, commit {commits}; its command is in [README.md](README.md).\n"
    )
    warnings, precision, reliability = warning_figures.load_all(folder)
    warned, precise, reliable = (
        only(rows, method=_METHOD) for rows in (warnings, precision, reliability)
    )
    pictures = "".join(
        f"![{_FIGURES[stem]}]({folder.path.name}/figures/{stem}.png)\n"
        for stem in figures
        if (folder.path / "figures" / f"{stem}.png").exists()
    )
    told = [f"Help was not measured (no {assistance_figure.DATA}).\n"]
    if helped:
        told = [_help(assistance_figure.load(folder.path / assistance_figure.DATA))]
    told.insert(0, _tested([run for run in runs if run.key.method == _METHOD]))
    if len(warned["seed"]) and len(precise["seed"]):
        told += [_warnings(warned), _precision(precise)]
    if len(reliable["seed"]):
        told.append(_reliability(reliable))
    return "\n".join([head, *told, pictures])


def _tested(runs: list[Run]) -> str:
    """What the human is worth whom the boundary calls as it was learned, in the sweep's tests."""
    if not runs:
        return "No run of HITL-AC has finished yet.\n"
    rows = [summarise_run(run) for run in runs]
    alone, helped, held, fell = (
        np.array([row[name] for row in rows], np.float64)
        for name in (
            "test_return_mean",
            "assisted_return_mean",
            "assisted_takeover_rate",
            "test_fall_rate",
        )
    )
    still = np.mean([select(run.tests, "mode", "assisted")["fall"].mean() for run in runs])
    gain = stats.estimate(helped - alone, stats.mean)
    return (
        f"In the sweep's tests the mean return is {alone.mean():.0f} alone and "
        f"{helped.mean():.0f} with the human, whom the boundary calls as it was learned: "
        f"{gain:+.0f} with {held.mean():.1%} of the steps in human hands. "
        f"{fell.mean():.0%} of the tests end in a fall alone, {still:.0%} with the human.\n"
    )


def _help(rows: Rows) -> str:
    """Gains and falls at each budget of human time, and how the learned boundary compares."""
    rules, budgets = rules_of(rows, _METHOD), np.array(BUDGETS)
    if not rules:
        return "No run of HITL-AC was tested with the human.\n"
    mine = (rows["method"] == _METHOD) & (rows["rule"] == assistance_figure.ALONE)
    alone = rows["return_mean"][mine].mean()
    fell = (rows["falls"][mine] / rows["episodes"][mine]).mean()
    lines = []
    for human in HUMANS:
        helps = {rule: help_at(rows, _METHOD, rule, human, budgets) for rule in rules}
        for place, budget in enumerate(BUDGETS):
            for rule, told in helps.items():
                ahead = "–"
                if rule != rules[0]:
                    ahead = _estimate(helps[rules[0]].gain[:, [place]] - told.gain[:, [place]])
                gain, falls = _estimate(told.gain[:, [place]]), told.falls[0, place]
                part = f"{falls / fell:.2f}" if np.isfinite(falls) and fell else "–"
                lines.append([human, f"{budget:.0%}", rule, gain, part, ahead])
    columns = (
        "the human",
        "steps in human hands",
        "the human is called by",
        "return above that alone",
        "falls, as a part of those alone",
        f"{rules[0]} ahead by",
    )
    at_rates = _at_rates(rows, rules, alone, fell)
    return (
        f"Alone, these walkers have a mean return of {alone:.0f} and fall in {fell:.0%} of their "
        "tests. With a human who judges and agrees or not, and with one who trusts every alarm, at "
        "equal human time (– where the human never acted so long):\n"
        f"\n{table([columns, *lines])}\n{at_rates}"
    )


def _at_rates(rows: Rows, rules: list[str], alone: float, fell: float) -> str:
    """Means over all tests at some rates of alarms."""
    lines = []
    for human, share in ((JUDGES, 0.05), (JUDGES, 0.2), (JUDGES, 1.0), (TRUSTS, 0.05)):
        for rule in rules:
            at = (rows["method"] == _METHOD) & (rows["rule"] == rule)
            at &= (rows["alarm_share"] == share) & (rows["human"] == human)
            if at.any():
                held = (rows["human_steps"][at] / rows["steps"][at]).mean()
                falls = (rows["falls"][at] / rows["episodes"][at]).mean()
                gain = rows["return_mean"][at].mean() - alone
                part = f"{falls / fell:.2f}" if fell else "–"
                lines.append([human, f"{share:.0%}", rule, f"{held:.1%}", f"{gain:.0f}", part])
    columns = (
        "the human",
        "steps with an alarm, alone",
        "the human is called by",
        "steps in human hands",
        "return above that alone",
        "falls, as a part of those alone",
    )
    head = (
        "At equal rates of alarms. With 100 % the human is always asked, but by the learned "
        "boundary, which stays within its bounds. A takeover lasts a second at least: who trusts "
        "chance has the controls most of the time from 5 % on.\n"
    )
    return f"\n{head}\n{table([columns, *lines])}\n"


def _warnings(rows: Rows) -> str:
    lines = []
    for name in dict.fromkeys(rows["indicator"].tolist()):
        own = only(rows, indicator=name)
        shares, warned, low, high = pooled_share(own, "warned_falls", "falls", "false_alarm_share")
        [at] = np.flatnonzero(shares == _FALSE_ALARMS)
        told = f"{warned[at]:.2f} [{low[at]:.2f}, {high[at]:.2f}]"
        lines.append([name, "too few falls to say" if np.isnan(warned[at]) else told])
    columns = ("alarms by", "falls warned of 0.8 s before")
    return (
        "Alone, with an alarm at 1 % of the steps that no fall follows within a second:\n\n"
        f"{table([columns, *lines])}\n"
    )


def _precision(rows: Rows) -> str:
    names = list(dict.fromkeys(rows["indicator"].tolist()))
    shares = {}
    for name in names:
        own = only(rows, indicator=name)
        recalls, shares[name], *_ = pooled_share(own, "timely_alarms", "alarms", "recall")
    lines = [
        [f"{recall:.2f}", *(f"{shares[name][place]:.2f}" for name in names)]
        for place, recall in enumerate(recalls)
    ]
    return (
        "Share of the alarms that a fall follows within a second, at equal shares of those steps "
        f"that have one:\n\n{table([['recall', *names], *lines])}\n"
    )


def _reliability(rows: Rows) -> str:
    _, foretold, *_ = pooled_share(rows, "risk_sum", "steps", "bin")
    _, came, *_ = pooled_share(rows, "falls_follow", "steps", "bin")
    error = np.nanmax(np.abs(foretold - came))
    return (
        "Over tenths of the foretold risk, what came differs from what was foretold by at most "
        f"{error:.2f}.\n"
    )


def _estimate(values: np.ndarray) -> str:
    """The value of all seeds with its interval; nothing where a twentieth of resamples lacks it."""
    if np.isnan(values[0, 0]) or np.isfinite(values[1:]).mean() < stats.LEVEL:
        return "–"
    (low,), (high,) = interval(values)
    return f"{values[0, 0]:.0f} [{low:.0f}, {high:.0f}]"
