"""Claims about training that no reset can bend: tests and falls over environment steps.

A test is autonomous. Runs are compared up to the same number of environment steps, for each seed
the least that its runs took.
"""

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.verdicts import SURE_AIM, Claim, in_order, in_resamples
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import Run

_WALKS = 200.0
_TESTED = 20
"""Test episodes, of one test or of several in a row, whose mean must reach it, at least."""
_FEWER_STEPS, _FEWER_FALLS = 1 / 2, 1 / 3
"""Of SRL's, what HITL-AC may take."""


def area(results: ComparedRuns) -> Claim | None:
    """The area under the tests, as one number for the speed of training."""
    tested = results.tested()
    if tested is None:
        return None
    until = np.min([[_steps(run) for run in results.runs[method]] for method in METHODS], 0)
    scores = {
        method: np.array(
            [
                _area(_steps_at(run, tested.points), returns, end)
                for run, returns, end in zip(
                    results.runs[method], tested.returns[method], until, strict=True
                )
            ]
        )
        for method in METHODS
    }
    verdict, sure = in_order(scores)
    means = ", ".join(
        f"{method.upper()} {stats.estimate(scores[method], stats.mean):.0f}"
        for method in reversed(METHODS)
    )
    return Claim(
        "Area under the tests",
        "–",
        "autonomous test return, averaged over the environment steps that all runs of a seed took: "
        f"the mean over seeds is told; {SURE_AIM}",
        f"{means}; {sure}",
        verdict,
        results.seeds,
    )


def steps_until_tested(results: ComparedRuns) -> Claim | None:
    """The steps until the walker alone walks well."""
    tested = results.tested()
    if tested is None:
        return None
    drawn = results.resampled()
    tests = -(-_TESTED // tested.episodes)
    medians, cells = {}, []
    for method in METHODS:
        passages = [
            _passage(_steps_at(run, tested.points), returns, tests)
            for run, returns in zip(results.runs[method], tested.returns[method], strict=True)
        ]
        steps = np.array(passages)
        medians[method] = stats.median(steps[drawn], 1)
        value, low, high = map(_thousands, stats.estimate(steps, stats.median)[:3])
        cells.append(f"{method.upper()} {value} [{low}, {high}]")
    few = medians["hitl-ac"] <= _FEWER_STEPS * medians["srl"]
    few &= np.isfinite(medians["hitl-ac"])
    verdict, share = in_resamples(few, list(medians.values()))
    return Claim(
        f"Steps to a test of {_WALKS:.0f}",
        "–",
        f"the median step at which the mean of at least {_TESTED} autonomous test episodes in a "
        f"row reaches {_WALKS:.0f} is for HITL-AC at most {_FEWER_STEPS:.2g} of SRL's",
        f"thousands of steps: {', '.join(reversed(cells))}; {share}",
        verdict,
        results.seeds,
    )


def falls(results: ComparedRuns) -> Claim:
    """Falls while training, up to the same number of steps."""
    pairs = list(zip(results.runs["hitl-ac"], results.runs["srl"], strict=True))
    counts = np.array([[_falls(run, min(map(_steps, pair))) for run in pair] for pair in pairs])
    own, others = counts.sum(0)
    resampled, srl = counts[results.resampled()].sum(1).T
    # Where SRL never falls there is nothing to spare.
    ratio = np.where(srl > 0, resampled / np.maximum(srl, 1), np.nan)
    low, high = stats.interval_of(ratio)
    verdict, share = in_resamples(ratio <= _FEWER_FALLS, [ratio])
    return Claim(
        "Falls during training",
        "–",
        "in the environment steps that both took, HITL-AC falls at most "
        f"{_FEWER_FALLS:.2f} times as often as SRL; a reset by the human is no fall",
        f"{own} falls beside {others}, a ratio in [{low:.2f}, {high:.2f}]; {share}",
        verdict,
        results.seeds,
    )


def _steps(run: Run) -> int:
    return int(run.episodes["env_steps"][-1])


def _steps_at(run: Run, points: np.ndarray) -> np.ndarray:
    """Environment steps until each test, [P]."""
    steps: np.ndarray = run.episodes["env_steps"][points - 1]
    return steps


def _area(steps: np.ndarray, returns: np.ndarray, until: int) -> float:
    """Mean return up to a step, straight between the tests, before the first one as that."""
    ends = np.unique([0, *steps[steps < until], until])
    return float(np.trapezoid(np.interp(ends, steps, returns), ends) / until)


def _passage(steps: np.ndarray, returns: np.ndarray, tests: int) -> float:
    """The step of the first test that ends so many in a row of a walker; infinite for never."""
    point = stats.first_passage(stats.trailing_mean(returns, tests), _WALKS, tests)
    if point is None:
        return np.inf
    return np.nan if np.isnan(point) else float(steps[int(point) - 1])


def _falls(run: Run, until: int) -> int:
    done = run.episodes["env_steps"] <= until
    return int(run.episodes["fall"][done].sum())


def _thousands(steps: float) -> str:
    return "never" if np.isinf(steps) else f"{steps / 1000:.0f}"
