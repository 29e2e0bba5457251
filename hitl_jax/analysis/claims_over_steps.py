"""Claims about training over environment steps, which a human's resets make fewer.

A test is autonomous. Runs are compared up to the same number of environment steps, for each seed
the least that its runs took. A run that diverged is not among these: from there on its tests count
as falls at once.
"""

from collections.abc import Sequence

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.claims_on_training import WALKS, thousands
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.summary import skill_over_training, was_tested
from hitl_jax.analysis.verdicts import SURE_AIM, Claim, in_order, in_resamples, told
from hitl_jax.results.episode_measures import FALL_REWARD
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import Run

_TESTED = 20
"""Test episodes, of one test or of several in a row, at least, whose mean must be a walker's."""
_UNTRAINED = FALL_REWARD
"""The return from which training begins: that of a fall at once."""
_LONGEST = 0.25
"""Of the tests, how many in a row may be asked for: more would speak of the end of training."""
_FEWER_STEPS, _FEWER_FALLS = 1 / 2, 1 / 3
"""Of SRL's, what HITL-AC may take."""
_PAIR = ("hitl-ac", "srl")
_SMALLEST = 20.0
"""Least difference of interest in the area under the tests, points of return."""
_FEWEST = 5.0
"""Seeds below which the normal approximation says nothing."""
_POWER = 1.960 + 0.842
"""Standard errors that a difference must be for that: quantiles 0.975 and 0.8 of the normal."""


def area(results: ComparedRuns) -> Claim | None:
    """The area under the tests, as one number for the speed of training; None without tests."""
    scores = _areas(results)
    if scores is None:
        return None
    verdict, sure = in_order(scores)
    return Claim(
        "Area under the tests",
        "–",
        "autonomous test return, straight between tests and from that of a fall at once before the "
        "first, averaged over the environment steps that all runs of a seed took: the mean over "
        f"seeds is told; {SURE_AIM}",
        f"{told(scores, stats.mean, '.0f')}; {sure}",
        verdict,
        results.seeds,
    )


def seeds_needed(results: ComparedRuns) -> Claim | None:
    """How many seeds would tell a small difference of that area; None without tests."""
    scores = _areas(results)
    if scores is None:
        return None
    cells = [
        f"{x.upper()} and {y.upper()} {stats.estimate(scores[x] - scores[y], _seeds_for):.0f}"
        for x, y in (("hitl-ac", "hitl-fix"), ("hitl-fix", "srl"))
    ]
    return Claim(
        "Seeds needed",
        "–",
        f"reported: seeds with which a difference of {_SMALLEST:.0f} between two means of that "
        "area would be found with a probability of 0.8 (paired, two-sided, level 0.05, normal "
        "approximation), from the standard deviation of the differences; the claim above asks for "
        "something else",
        ", ".join(cells),
        "–",
        results.seeds,
    )


def _seeds_for(differences: np.ndarray, axis: int) -> np.ndarray:
    """Seeds that tell `_SMALLEST` from none, given the differences of some seeds along an axis."""
    needed = (_POWER * np.std(differences, axis=axis, ddof=1) / _SMALLEST) ** 2
    seeds: np.ndarray = np.ceil(np.maximum(needed, _FEWEST))
    return seeds


def steps_until_tested(results: ComparedRuns) -> Claim | None:
    """The steps until the walker alone walks well; None where too few episodes are tested."""
    tested = results.tested()
    if tested is None:
        return None
    first = tested[METHODS[0]]
    tests = -(-_TESTED // first.episodes)
    if tests > max(_LONGEST * len(first.points), 1):
        return None
    drawn = results.resampled()
    medians, cells = {}, []
    for method, skill in tested.items():
        passages = [
            _passage(_steps_at(run, skill.points), returns, tests)
            for run, returns in zip(results.runs[method], skill.returns, strict=True)
        ]
        steps = np.array(passages)
        medians[method] = stats.median(steps[drawn], 1)
        value, low, high = map(thousands, stats.estimate(steps, stats.median)[:3])
        cells.append(f"{method.upper()} {value} [{low}, {high}]")
    few = medians["hitl-ac"] <= _FEWER_STEPS * medians["srl"]
    few &= np.isfinite(medians["hitl-ac"])
    verdict, share = in_resamples(few, list(medians.values()))
    return Claim(
        f"Steps to a test of {WALKS:.0f}",
        "–",
        f"the median step at which the mean of at least {_TESTED} autonomous test episodes in a "
        f"row reaches {WALKS:.0f} is for HITL-AC at most {_FEWER_STEPS:.2g} of SRL's",
        f"thousands of steps: {', '.join(reversed(cells))}; {share}",
        verdict,
        results.seeds,
    )


def falls(results: ComparedRuns) -> Claim:
    """Falls while training, up to the same number of steps."""
    until = _common_steps(results, _PAIR)
    counts = np.array(
        [
            [_falls(run, steps) for run, steps in zip(results.runs[method], until, strict=True)]
            for method in _PAIR
        ]
    )
    own, srl = counts[:, results.resampled()].sum(2)
    # Where neither falls there is nothing to compare.
    ratio = np.divide(own, srl, out=np.where(own > 0, np.inf, np.nan), where=srl > 0)
    verdict, share = in_resamples(ratio <= _FEWER_FALLS, [ratio])
    few, many = counts.sum(1)
    value = few / many if many else np.inf
    low, high = stats.interval_of(ratio)
    return Claim(
        "Falls during training",
        "–",
        "in the environment steps that both took, HITL-AC falls at most "
        f"{_FEWER_FALLS:.2f} times as often as SRL; a reset by the human is no fall",
        f"{few} falls beside {many}: {value:.2f} [{low:.2f}, {high:.2f}]; {share}",
        verdict,
        results.seeds,
    )


def area_of(run: Run, points: Sequence[int]) -> float | None:
    """The area under one run's tests over the steps that it took.

    Args:
        run: a finished run.
        points: numbers of training episodes after each of which it was to be tested. A run that
            went on from a save of an earlier commit may lack some.

    Returns:
        The mean return; None where a test is lacking.
    """
    if not was_tested(run):
        return None
    skill = skill_over_training([run])
    if not set(points) <= set(skill.points.tolist()):
        return None
    taken = float(run.played["env_steps"][-1:].sum())
    return _area(_steps_at(run, skill.points), skill.returns[0], taken)


def _areas(results: ComparedRuns) -> dict[str, np.ndarray] | None:
    """Of each method the mean test of each seed up to their common steps, [S]."""
    tested = results.tested()
    if tested is None:
        return None
    until = _common_steps(results, METHODS)
    return {
        method: np.array(
            [
                _area(_steps_at(run, skill.points), returns, end)
                for run, returns, end in zip(
                    results.runs[method], skill.returns, until, strict=True
                )
            ]
        )
        for method, skill in tested.items()
    }


def _common_steps(results: ComparedRuns, methods: Sequence[str]) -> np.ndarray:
    """Of each seed the steps that its runs took, of those that did not diverge the least, [S]."""
    steps = np.array(
        [[run.played["env_steps"][-1:].sum() for run in results.runs[method]] for method in methods]
    )
    diverged = np.array(
        [[bool(run.diverged) for run in results.runs[method]] for method in methods]
    )
    sound = np.where(diverged & ~diverged.all(0), np.inf, steps)
    return sound.min(0)


def _steps_at(run: Run, points: np.ndarray) -> np.ndarray:
    """Environment steps until each test, [P]."""
    steps: np.ndarray = run.episodes["env_steps"][points - 1]
    return steps


def _area(steps: np.ndarray, returns: np.ndarray, until: float) -> float:
    """Mean return up to a step, straight between an untrained walker and the tests."""
    steps, returns = np.append(0, steps), np.append(_UNTRAINED, returns)
    ends = np.unique([*steps[steps < until], until])
    return float(np.trapezoid(np.interp(ends, steps, returns), ends) / until)


def _passage(steps: np.ndarray, returns: np.ndarray, tests: int) -> float:
    """The step of the first test that ends so many in a row of a walker; infinite for never."""
    point = stats.first_passage(stats.trailing_mean(returns, tests), WALKS, tests)
    if point is None:
        return np.inf
    return np.nan if np.isnan(point) else float(steps[int(point) - 1])


def _falls(run: Run, until: float) -> int:
    """Falls in the episodes that were played up to a step."""
    return int(run.played["fall"][run.played["env_steps"] <= until].sum())
