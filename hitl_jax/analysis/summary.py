"""The tables of a results folder: a row for each run, and what the seeds say about each method."""

import pathlib
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.markdown import table_line
from hitl_jax.analysis.task_facts import marks_of, steps_per_second_of
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.episode_measures import LOST_TESTS
from hitl_jax.results.episode_tables import Table, rows_to_csv, select
from hitl_jax.results.folder import ResultsFolder, Run

WINDOW = 100
"""Episodes in the trailing mean."""

PAIRS = (("hitl-ac", "hitl-fix"), ("hitl-fix", "srl"), ("hitl-ac", "srl"))
"""(X, Y) of the probabilities that X improves on Y."""

Row = dict[str, Any]
"""One run's measures; None where there is no value."""

_COLUMNS = (
    "method",
    "seed",
    "episodes",
    "env_steps",
    "final_return_100",
    "best_return_100",
    "test_return_mean",
    "test_return_std",
    "test_fall_rate",
    "assisted_return_mean",
    "assisted_takeover_rate",
    "assisted_interventions_per_episode",
    "train_interventions",
    "train_human_steps",
    "alarm_agreement",
    "alarm_precision",
    "alarm_recall",
    "alarm_lead_steps",
    "alarm_lead_seconds",
    "final_boundary",
    "diverged",
    "wall_seconds",
)
_BEFORE = _COLUMNS.index("test_return_mean")
"""Where the columns of the marks stand."""

_MEASURES = (
    ("test_return_mean", "autonomous test return", 1),
    ("test_fall_rate", "autonomous test: share of episodes with a fall", 2),
    ("assisted_return_mean", "assisted test return", 1),
    ("assisted_takeover_rate", "assisted test: share of steps under the human", 4),
    ("assisted_interventions_per_episode", "assisted test: interventions an episode", 2),
    ("final_return_100", "training return, last 100 episodes", 1),
    ("best_return_100", "training return, best 100 episodes in a row", 1),
    ("env_steps", "training: environment steps", 0),
    ("train_interventions", "training: interventions", 0),
    ("train_human_steps", "training: steps under the human", 0),
    ("alarm_agreement", "training: share of alarms that the human confirms", 2),
    ("alarm_precision", "test: share of alarms that a fall follows within k steps", 2),
    ("alarm_recall", "test: share of falls with an alarm in the k steps before", 2),
    ("alarm_lead_seconds", "test: time from the first such alarm to the fall [s]", 2),
    ("final_boundary", "boundary at the end of training", 3),
)
"""(column, name, decimals) of the measures in summary.md."""

_READING_GUIDE = """\
Returns are the environment's own reward; the human's feedback is left out. The autonomous test has
neither human nor arbiter, the assisted test has both. An interquartile mean leaves out the best and
the worst quarter of the seeds (rounded down). Intervals come from resampling seeds: they speak of
other seeds of this setting, not of other tasks, and with fewer than about five seeds they are too
narrow; what is the same in all seeds gets no width, and one seed has no interval. "(n = 7)" marks a
measure that only 7 of the finished seeds have, "–" one that none has. For alarms and falls, k is
the window that the runs were recorded with. A probability of improvement of 0.5 is no difference,
and an interval that holds 0.5 decides nothing. A median counts a seed that never reaches a mark as
infinitely late. `wall_seconds` in summary.csv is from the first step of a run to the end of its
tests, beside the other runs of its batch on the same processor: it is not what the run alone
costs."""


def summary_columns(marks: Sequence[int]) -> tuple[str, ...]:
    """The columns of summary.csv.

    Args:
        marks: of `marks_of`.
    """
    passages = (f"{unit}_to_{mark}" for mark in marks for unit in ("episodes", "steps"))
    return (*_COLUMNS[:_BEFORE], *passages, *_COLUMNS[_BEFORE:])


SUMMARY_COLUMNS = summary_columns(marks_of({}))
"""Of the walker."""


def summarise(folder: ResultsFolder) -> tuple[Row, ...]:
    """The measures of every finished run, keys `summary_columns`.

    Raises:
        ResultsError: if a run is damaged.
    """
    return tuple(summarise_run(run) for run in folder.load_all())


def write_summary(folder: ResultsFolder, runs: list[Run] | None = None) -> list[pathlib.Path]:
    """Writes summary.csv, a row for each finished run, and summary.md, the methods compared.

    Args:
        folder: the results.
        runs: its finished runs; None reads them.

    Returns:
        The two files.

    Raises:
        ResultsError: if a run is damaged or a file cannot be written.
    """
    runs = folder.load_all() if runs is None else runs
    rows = [summarise_run(run) for run in runs]
    unfinished = Counter(key.method for key in folder.load_partials())
    table, report = folder.path / "summary.csv", folder.path / "summary.md"
    marks = marks_of(folder.load_config())
    write_text_atomic(table, rows_to_csv(rows, summary_columns(marks)))
    write_text_atomic(report, _report(runs, unfinished, marks))
    return [table, report]


class SkillOverTraining(NamedTuple):
    """Mean test returns at points of training, the end last.

    Attributes:
        points: training episodes until then, [P].
        returns: of each run, [S, P].
        episodes: of each test.
    """

    points: np.ndarray
    returns: np.ndarray
    episodes: int


NOT_TESTED = SkillOverTraining(np.empty(0, int), np.empty((0, 0)), 0)
"""Where no run was tested during training."""


def skill_over_training(runs: Sequence[Run], mode: str = "autonomous") -> SkillOverTraining:
    """What runs could do at the points of training at which all of them were tested.

    At every point over the same terrains: of the test at the end, the first episodes alone.

    Args:
        runs: finished runs that were tested in this mode during training, as many training episodes
            each; one at least.
        mode: `autonomous` or `assisted`.
    """
    earlier = [select(run.progress, "mode", mode) for run in runs]
    points = np.unique(earlier[0]["trained"])
    for tests in earlier[1:]:
        points = np.intersect1d(points, tests["trained"])
    tests_at = [select(tests, "trained", point) for tests in earlier for point in points]
    each = min(int(tests["episode"].max()) for tests in tests_at or earlier)
    returns = [
        [*(_mean(select(tests, "trained", point), each) for point in points), _mean(end, each)]
        for tests, end in zip(
            earlier, (select(run.tests, "mode", mode) for run in runs), strict=True
        )
    ]
    return SkillOverTraining(
        np.append(points, len(runs[0].episodes["episode"])), np.array(returns), each
    )


def was_tested(run: Run, mode: str = "autonomous") -> bool:
    """Whether a run was tested during training in a mode, and at its end."""
    return bool((run.progress["mode"] == mode).any() and (run.tests["mode"] == mode).any())


def _mean(tests: Table, episodes: int) -> float:
    """Mean return of the first episodes of a test."""
    return float(tests["return"][tests["episode"] <= episodes].mean())


def summarise_run(run: Run) -> Row:
    """The measures of one run, keys `summary_columns`."""
    episodes, tests = run.episodes, run.tests
    config = run.info.get("config", {})
    marks = marks_of(config)
    trailing = stats.trailing_mean(episodes["return"], WINDOW)
    autonomous, assisted = select(tests, "mode", "autonomous"), select(tests, "mode", "assisted")
    row: Row = {
        "method": run.key.method,
        "seed": run.key.seed,
        "episodes": len(trailing),
        "env_steps": _last(episodes["env_steps"]),
        "final_return_100": _last(trailing),
        # Before the window is full a trailing mean is of a lucky few; a short run has but its last.
        "best_return_100": _value(np.max, trailing[min(WINDOW, len(trailing)) - 1 :]),
        "test_return_mean": _value(np.mean, autonomous["return"]),
        "test_return_std": _value(np.std, autonomous["return"]),
        "test_fall_rate": _value(np.mean, autonomous["fall"]),
        "assisted_return_mean": _value(np.mean, assisted["return"]),
        "assisted_takeover_rate": _ratio(assisted["human_steps"], assisted["length"]),
        "assisted_interventions_per_episode": _value(np.mean, assisted["interventions"]),
        # What a run that diverged spared its human is no merit.
        "train_interventions": None if run.diverged else episodes["interventions"].sum().item(),
        "train_human_steps": None if run.diverged else episodes["human_steps"].sum().item(),
        "alarm_agreement": _ratio(
            episodes["true_alarms"], episodes["true_alarms"] + episodes["false_alarms"]
        ),
        "final_boundary": _known(_last(episodes["final_boundary"])),
        "diverged": int(run.diverged),
        "wall_seconds": run.info["wall_seconds"],
    }
    for mark in marks:
        passage = stats.first_passage(trailing, mark, WINDOW)
        row[f"episodes_to_{mark}"] = passage
        row[f"steps_to_{mark}"] = steps_at(episodes, passage)
    row |= _alarms_before_falls(autonomous, steps_per_second_of(config))
    return {name: row[name] for name in summary_columns(marks)}


def steps_at(episodes: Table, passage: float | None) -> float | None:
    """Environment steps at the end of the episode of a first passage; None or NaN as that is."""
    if passage is None or np.isnan(passage):
        return passage
    return int(episodes["env_steps"][int(passage) - 1])


def _alarms_before_falls(autonomous: Table, steps_per_second: float) -> Row:
    """How well alarms foretell falls where no human interferes: "falls within k steps" is truth."""
    fallen = autonomous["fall"] == 1
    lead = autonomous["lead_steps"][fallen]
    warned = ~np.isnan(lead)
    # Without an arbiter there are no alarms to judge: a recall of 0 would be a verdict.
    judged = bool((~np.isnan(autonomous["mean_boundary"])).any())
    steps = _value(np.mean, lead[warned])
    return {
        "alarm_precision": _ratio(autonomous["alarms_before_fall"], autonomous["alarms"]),
        "alarm_recall": _value(np.mean, warned) if judged else None,
        "alarm_lead_steps": steps,
        "alarm_lead_seconds": None if steps is None else steps / steps_per_second,
    }


def _report(runs: list[Run], unfinished: Counter[str], marks: Sequence[int]) -> str:
    rows = tuple(summarise_run(run) for run in runs)
    finished = Counter(row["method"] for row in rows)
    methods = list(finished)
    lost = Counter({run.key: run.lost_tests for run in runs})
    lines = ["# Summary", ""]
    for m in finished | unfinished:
        line = f"- {m}: seeds finished {finished[m]}, under way {unfinished[m]}"
        if diverged := [str(row["seed"]) for row in rows if row["method"] == m and row["diverged"]]:
            line += f"; diverged, counted as falling at once from there on: {', '.join(diverged)}"
        if told := [f"seed {key.seed} has {n}" for key, n in (+lost).items() if key.method == m]:
            line += f"; {LOST_TESTS}: {', '.join(told)}"
        lines.append(line)
    if not rows:
        return "\n".join([*lines, "", "No run has finished yet: nothing to summarise.", ""])
    lines += ["", _READING_GUIDE, ""]
    estimators = (("Interquartile mean", stats.interquartile_mean), ("Mean", stats.mean))
    for title, statistic in estimators:
        lines += [f"## {title} over seeds [bootstrap 95 % interval]", ""]
        lines += _table_head(["measure", *methods])
        for column, name, decimals in _MEASURES:
            cells = [_cell(_scores(rows, m, column), statistic, decimals) for m in methods]
            lines.append(table_line([name, *cells]))
        lines.append("")
    if marks:
        lines += ["## Until the mean of the last 100 training returns reaches a mark", ""]
        lines += _table_head(["mark", *methods])
        for mark in marks:
            lines.append(table_line([str(mark), *(_passage(rows, m, mark) for m in methods)]))
        lines.append("")
    lines += ["## Probability of improvement on the autonomous test return", ""]
    lines += _table_head(["X over Y", "P(X > Y) [95 % interval]", "paired seeds"])
    lines += [_improvement(rows, x, y) for x, y in PAIRS]
    return "\n".join([*lines, ""])


def _scores(rows: tuple[Row, ...], method: str, column: str) -> list[float | None]:
    return [row[column] for row in rows if row["method"] == method]


def _cell(scores: list[float | None], statistic: stats.Statistic, decimals: int) -> str:
    values = np.array([score for score in scores if score is not None], dtype=float)
    if not values.size:
        return "–"
    text = f"{stats.estimate(values, statistic):.{decimals}f}"
    return text if values.size == len(scores) else f"{text} (n = {values.size})"


def _passage(rows: tuple[Row, ...], method: str, mark: int) -> str:
    """Medians with "never" as infinity, so that seeds that fail count against the method."""
    medians = []
    for unit in ("episodes", "steps"):
        scores = _scores(rows, method, f"{unit}_to_{mark}")
        steps = np.array([np.inf if score is None else score for score in scores])
        medians.append(stats.median(steps, 0))
    reached = sum(score is not None for score in scores)
    share = f"{reached} of {len(scores)} seeds"
    if np.isinf(medians[0]):
        return share
    return f"{share}; median episode {medians[0]:.0f}, step {medians[1]:.0f}"


def _improvement(rows: tuple[Row, ...], x: str, y: str) -> str:
    scores = {(row["method"], row["seed"]): row["test_return_mean"] for row in rows}
    seeds = sorted({row["seed"] for row in rows})
    pairs = [(scores.get((x, seed)), scores.get((y, seed))) for seed in seeds]
    paired = np.array([pair for pair in pairs if None not in pair], dtype=float).reshape(-1, 2)
    cell = "–"
    if len(paired):
        cell = f"{stats.probability_of_improvement(paired[:, 0], paired[:, 1]):.2f}"
    return table_line([f"{x} over {y}", cell, str(len(paired))])


def _table_head(cells: list[str]) -> list[str]:
    return [table_line(cells), table_line(["---"] * len(cells))]


def _value(statistic: Any, values: np.ndarray) -> float | None:
    return float(statistic(values)) if len(values) else None


def _ratio(part: np.ndarray, whole: np.ndarray) -> float | None:
    total = float(whole.sum())
    return float(part.sum()) / total if total else None


def _last(values: np.ndarray) -> Any:
    return values[-1].item() if len(values) else None


def _known(value: Any) -> Any:
    """None for the NaN that stands in a table where there is no boundary."""
    return None if value != value else value  # NaN alone differs from itself.
