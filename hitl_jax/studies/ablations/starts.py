"""The claims about τ_0: what a learned boundary saves over a fixed one, wherever it starts."""

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.claims import (
    HOLDS,
    HOLDS_NOT,
    MARGIN,
    RESAMPLES,
    UNDECIDED,
    Claim,
    share_of,
    verdict_of,
)
from hitl_jax.studies.ablations.store import Row

_RETURN = "test_return_mean"

Starts = dict[str, list[Row]]
"""Runs of one method by the label of their τ_0."""


def judge_starts(fixed: Starts, learned: Starts, default: str) -> list[Claim]:
    """Three claims, from the same seeds of both methods.

    Args:
        fixed: HITL-FIX's runs.
        learned: HITL-AC's, of the same τ_0.
        default: the label of the τ_0 from which HITL-AC starts when nobody chooses.
    """
    means = {label: _mean(runs, _RETURN) for label, runs in fixed.items()}
    best = max(means, key=lambda label: (np.isnan(means[label]), means[label]))
    return [
        _from_anywhere(fixed, learned),
        _no_worse_than_the_best(fixed[best], learned[default], best),
        _less_work(fixed[best], learned[default], best),
    ]


def _from_anywhere(fixed: Starts, learned: Starts) -> Claim:
    cells, verdicts = [], []
    for label in fixed:
        gain, low, high = _difference(learned[label], fixed[label], np.random.default_rng(0))
        cells.append(f"from {label}: {gain:+.0f} [{low:+.0f}, {high:+.0f}]")
        verdicts.append(HOLDS if low > 0 else HOLDS_NOT if high < 0 else UNDECIDED)
    return Claim(
        "A learned boundary beats a fixed one from any τ_0",
        "HITL-AC above HITL-FIX, from one τ_0",
        "mean autonomous test return of HITL-AC above HITL-FIX's, from every τ_0 (below the "
        "human's own threshold no intervention depends on τ, and the two are one method)",
        "; ".join(cells),
        HOLDS_NOT if HOLDS_NOT in verdicts else UNDECIDED if UNDECIDED in verdicts else HOLDS,
    )


def _no_worse_than_the_best(fixed: list[Row], learned: list[Row], best: str) -> Claim:
    gain, low, high = _difference(learned, fixed, np.random.default_rng(0))
    return Claim(
        "It is no worse than the best fixed one",
        "–",
        f"mean autonomous test return of HITL-AC, from its default τ_0, not {MARGIN:g} below that "
        "of HITL-FIX at the best τ_0 of the table",
        f"{gain:+.0f} [{low:+.0f}, {high:+.0f}] against τ_0 = {best}",
        HOLDS if low > -MARGIN else HOLDS_NOT if high < -MARGIN else UNDECIDED,
    )


def _less_work(fixed: list[Row], learned: list[Row], best: str) -> Claim:
    drawn = np.random.default_rng(0).integers(len(fixed), size=(RESAMPLES, len(fixed)))
    everyone = np.arange(len(fixed))
    costs = [[_cost(runs, seeds) for runs in (learned, fixed)] for seeds in (everyone, drawn)]
    (ours, theirs), (our_draws, their_draws) = costs
    fewer = share_of(our_draws < their_draws, (our_draws, their_draws))
    return Claim(
        "Less human work",
        "–",
        "alarms that HITL-AC's human has to judge for a point of autonomous test return fewer than "
        "HITL-FIX's at the best τ_0 of the table",
        f"{ours:.2f} against {theirs:.2f} at τ_0 = {best}; fewer in {100 * fewer:.0f} % of "
        "resamples of the seeds",
        verdict_of(fewer),
    )


def _cost(runs: list[Row], seeds: np.ndarray) -> np.ndarray:
    """Alarms over return, of the mean over some seeds [..., S]; infinite without any return."""
    # Each confirmed alarm is an intervention; with the default, reset, there are no others.
    alarms = _values(runs, "train_interventions") / _values(runs, "alarm_agreement")
    work, gained = alarms[seeds].mean(-1), _values(runs, _RETURN)[seeds].mean(-1)
    return np.where(gained <= 0, np.inf, work / np.maximum(gained, 1e-9))


def _difference(
    better: list[Row], worse: list[Row], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Mean of the seeds' differences in test return, with its interval."""
    gains = _values(better, _RETURN) - _values(worse, _RETURN)
    low, high = stats.bootstrap_interval(gains, stats.mean, rng)
    return float(gains.mean()), float(low), float(high)


def _mean(runs: list[Row], measure: str) -> float:
    return float(_values(runs, measure).mean())


def _values(runs: list[Row], measure: str) -> np.ndarray:
    return np.array([run[measure] for run in runs], float)
