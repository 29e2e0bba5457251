"""Claims about what a walker can do for the time that the human has spent on it."""

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.task_facts import STEPS_PER_SECOND, steps_per_second_of
from hitl_jax.analysis.verdicts import Claim, least, of_sign, told
from hitl_jax.results.episode_measures import FALL_REWARD
from hitl_jax.results.folder import Run

BUDGETS = (30, 60, 120, 300, 600)
"""Seconds in human hands."""
_PAIR = ("hitl-fix", "hitl-ac")


def human_seconds(run: Run, points: np.ndarray) -> np.ndarray:
    """Time in human hands until each test, [P].

    Args:
        run: the run.
        points: training episodes before each test, [P].
    """
    steps: np.ndarray = np.cumsum(run.episodes["human_steps"])[points - 1]
    return steps / steps_per_second_of(run.info.get("config", {}))


def return_for_human_time(results: ComparedRuns) -> Claim | None:
    """Whether HITL-AC's walkers are better for equal human time; None where no human acts."""
    tested = results.tested()
    spent = {
        method: np.array([run.played["human_steps"].sum() for run in results.runs[method]])
        / STEPS_PER_SECOND
        for method in _PAIR
    }
    if tested is None or not all(seconds.any() for seconds in spent.values()):
        return None
    cells, leads, verdicts = [], [], []
    for budget in BUDGETS:
        scores = {
            method: np.array(
                [
                    _at(human_seconds(run, tested[method].points), returns, budget)
                    for run, returns in zip(
                        results.runs[method], tested[method].returns, strict=True
                    )
                ]
            )
            for method in _PAIR
        }
        ahead = stats.estimate(scores["hitl-ac"] - scores["hitl-fix"], stats.mean)
        verdicts.append(of_sign(ahead))
        leads.append(f"{ahead:+.0f} at {budget} s")
        cells.append(f"{budget} s: {told(scores, stats.mean, '.0f')}, ahead by {ahead:+.0f}")
    return Claim(
        "Return for human time",
        "–",
        "autonomous test return where the human has acted for so long, straight between tests and "
        "from that of a fall at once before the first; that of the end where the human acted for "
        "less: HITL-AC's mean over seeds above HITL-FIX's, with an interval above 0, at each of "
        f"{', '.join(map(str, BUDGETS))} s",
        f"{'; '.join(cells)}. In all the human acted for {told(spent, stats.mean, '.0f')} s",
        least(verdicts),
        results.seeds,
        f"HITL-AC ahead by {', '.join(leads)}",
    )


def _at(seconds: np.ndarray, returns: np.ndarray, budget: float) -> float:
    """The test return where the human has acted for so long."""
    before = int(np.searchsorted(seconds, budget, side="right"))
    if before == len(seconds):
        return float(returns[-1])
    # The last of those without a second more between them is the walker of that time.
    seconds, returns = np.append(0.0, seconds), np.append(FALL_REWARD, returns)
    left, right = before, before + 1
    share = (budget - seconds[left]) / (seconds[right] - seconds[left])
    return float(returns[left] + share * (returns[right] - returns[left]))
