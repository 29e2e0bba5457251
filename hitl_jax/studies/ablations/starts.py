"""The claims about τ_0: what a learned boundary saves over a fixed one, wherever it starts."""

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.verdicts import (
    MARGIN,
    Claim,
    least,
    of_sign,
    share_of,
    verdict_of,
)
from hitl_jax.studies.ablations.store import Row

_RETURN = "test_return_mean"

Starts = dict[str, list[Row]]
"""Runs of one method by the label of their τ_0, which begins with the number."""


def judge_starts(fixed: Starts, learned: Starts, base: str, tolerance: float) -> list[Claim]:
    """Three claims, from the same seeds of both methods.

    Args:
        fixed: HITL-FIX's runs.
        learned: HITL-AC's, of the same τ_0.
        base: the label of the base's τ_0.
        tolerance: hull angle from which the human sees danger [rad].
    """
    means = {label: _mean(runs, _RETURN) for label, runs in fixed.items()}
    best = max(means, key=lambda label: (np.isnan(means[label]), means[label]))
    return [
        _from_anywhere(fixed, learned, tolerance),
        _no_worse_than_the_best(fixed[best], learned[base], best),
        _less_work(fixed[best], learned[base], best),
    ]


def _from_anywhere(fixed: Starts, learned: Starts, tolerance: float) -> Claim:
    gains = {label: _difference(learned[label], fixed[label]) for label in fixed}
    measured = "; ".join(f"from {label}: {gain:+.0f}" for label, gain in gains.items())
    # There an intervention needs |c_t| >= the tolerance in both methods, whatever τ_t is.
    alike = [label for label in fixed if float(label.split()[0]) <= tolerance]
    if alike:
        measured += (
            f". From τ_0 = {' and '.join(alike)}, at most the human's tolerance of {tolerance:g} "
            "rad, neither method's interventions depend on τ: its seeds draw other random numbers, "
            f"and the difference there is what the means of {gains[alike[0]].seeds} seeds vary by"
        )
    return Claim(
        "A learned boundary beats a fixed one from any τ_0",
        "HITL-AC above HITL-FIX, from one τ_0",
        "mean autonomous test return of HITL-AC above HITL-FIX's, from every τ_0",
        measured,
        least([of_sign(gain) for gain in gains.values()]),
        len(next(iter(fixed.values()))),
    )


def _no_worse_than_the_best(fixed: list[Row], learned: list[Row], best: str) -> Claim:
    gain = _difference(learned, fixed)
    return Claim(
        "It is no worse than the best fixed one",
        "–",
        f"mean autonomous test return of HITL-AC, from the base's τ_0, not {MARGIN:g} below that "
        "of HITL-FIX at the best τ_0 of the table",
        f"{gain:+.0f} against τ_0 = {best}",
        of_sign(gain, -MARGIN),
        gain.seeds,
    )


def _less_work(fixed: list[Row], learned: list[Row], best: str) -> Claim:
    (ours, our_draws), (theirs, their_draws) = map(_cost, (learned, fixed))
    fewer = share_of(our_draws < their_draws, (our_draws, their_draws))
    return Claim(
        "Less human work",
        "–",
        "alarms that HITL-AC's human has to judge for a point of autonomous test return fewer than "
        "HITL-FIX's at the best τ_0 of the table",
        f"{ours:.2f} against {theirs:.2f} at τ_0 = {best}; fewer in {100 * fewer:.0f} % of "
        "resamples of the seeds",
        verdict_of(fewer),
        len(fixed),
    )


def _cost(runs: list[Row]) -> tuple[stats.Estimate, np.ndarray]:
    """Mean alarms over mean return, infinite without any return; and that of each resample."""
    # Each confirmed alarm is an intervention; with the base, reset, there are no others.
    alarms = _values(runs, "train_interventions") / _values(runs, "alarm_agreement")
    returns = _values(runs, _RETURN)

    def cost(seeds: np.ndarray) -> np.ndarray:
        work, gained = alarms[seeds].mean(-1), returns[seeds].mean(-1)
        return np.where(gained <= 0, np.inf, work / np.maximum(gained, 1e-9))

    draws = cost(stats.resampled_seeds(len(runs)))
    low, high = stats.interval_of(draws)
    everyone = np.arange(len(runs))
    return stats.Estimate(float(cost(everyone)), float(low), float(high), len(runs)), draws


def _difference(better: list[Row], worse: list[Row]) -> stats.Estimate:
    """Mean of the seeds' differences in test return."""
    return stats.estimate(_values(better, _RETURN) - _values(worse, _RETURN), stats.mean)


def _mean(runs: list[Row], measure: str) -> float:
    return float(_values(runs, measure).mean())


def _values(runs: list[Row], measure: str) -> np.ndarray:
    return np.array([run[measure] for run in runs], float)
