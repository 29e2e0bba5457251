"""Claims about the tests: skill without the human, help by them, and alarms before falls."""

import numpy as np

from hitl_jax.analysis import stats, summary
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.task_facts import STEPS_PER_SECOND
from hitl_jax.analysis.verdicts import (
    MARGIN,
    SURE_AIM,
    Claim,
    in_order,
    in_resamples,
    of_sign,
    told,
)
from hitl_jax.results.episode_tables import METHODS, MODES, select

_GOOD = 300.0
_ALONE = "test_return_mean"
_TOLD = 6
"""Points of training that are told at most, the first and the last among them."""


def skill(results: ComparedRuns) -> Claim:
    """Figure 5: the order of the methods in the autonomous test."""
    drawn = results.resampled()
    centres, cells = [], []
    for method in METHODS:
        scores = _scores(results, method)
        centres.append(stats.interquartile_mean(scores[drawn], 1))
        centre = stats.estimate(scores, stats.interquartile_mean)
        cells.append(
            f"{method.upper()} {centre:.1f} (mean {stats.estimate(scores, stats.mean):.1f})"
        )
    srl, fix, ac = centres
    verdict, share = in_resamples((ac >= _GOOD) & (ac > fix) & (fix > srl), centres)
    return Claim(
        "Skill without the human (Figure 5)",
        "over 100 test episodes HITL-AC 279.7, HITL-FIX 260.5, SRL below",
        f"interquartile means of the autonomous test return: HITL-AC's at least {_GOOD:.0f} and "
        "above that of HITL-FIX with the same τ_0, and HITL-FIX's above SRL's",
        f"{', '.join(reversed(cells))}; {share}",
        verdict,
        results.seeds,
    )


def skill_over_training(results: ComparedRuns) -> Claim | None:
    """The autonomous tests during training; None where a run was not tested then."""
    tested = results.tested()
    if tested is None:
        return None
    skill = tested[METHODS[0]]
    cells = []
    for place in np.unique(np.linspace(0, len(skill.points) - 1, _TOLD).astype(int)):
        scores = {method: of.returns[:, place] for method, of in tested.items()}
        centres = told(scores, stats.interquartile_mean, ".0f")
        cells.append(f"episode {skill.points[place]}: {centres}")
    return Claim(
        "Skill over training",
        "–",
        "reported: interquartile mean of the autonomous test return at points of training, over "
        f"the same {skill.episodes} test episodes of a run at each",
        "; ".join(cells),
        "–",
        results.seeds,
    )


def improvement(results: ComparedRuns) -> Claim:
    """How often one method is above another on the same seed."""
    verdict, sure = in_order({method: _scores(results, method) for method in METHODS})
    return Claim(
        "How sure that order is",
        "one run of each method",
        SURE_AIM,
        sure,
        verdict,
        results.seeds,
    )


def assistance(results: ComparedRuns) -> Claim:
    """Whether the human's help in the test raises the return."""
    gains = []
    for run in results.runs["hitl-ac"]:
        alone, helped = (
            select(run.tests, "mode", mode)["return"].mean() for mode in ("autonomous", "assisted")
        )
        gains.append(helped - alone)
    gain = stats.estimate(np.array(gains), stats.mean)
    return Claim(
        "Help in the test",
        "the boundary guides the agent to seek the human's intervention",
        f"HITL-AC's mean assisted test return more than {MARGIN:.0f} above its autonomous one",
        f"{gain:+.1f}; above it by more than 1 in {(np.array(gains) > 1).sum()} of "
        f"{gain.seeds} seeds",
        of_sign(gain, MARGIN),
        results.seeds,
    )


def assistance_during_training(results: ComparedRuns) -> Claim | None:
    """The same over the points of training; None where a run was not tested so."""
    runs = results.runs["hitl-ac"]
    if not all(summary.was_tested(run, mode) for run in runs for mode in MODES):
        return None
    alone, helped = (summary.skill_over_training(runs, mode) for mode in MODES)
    gains = (helped.returns - alone.returns)[:, :-1]
    if not gains.size:
        return None
    at_points = gains.mean(0)
    gain = stats.estimate(gains.mean(1), stats.mean)
    return Claim(
        "Help in the test, over training",
        "the boundary guides the agent to seek the human's intervention",
        "HITL-AC's mean assisted test return is above its autonomous one, over the points of "
        "training before the last",
        f"{gain:+.1f}; above it at {(at_points > 0).sum()} of {len(at_points)} points, from "
        f"{at_points.min():+.0f} to {at_points.max():+.0f}",
        of_sign(gain),
        results.seeds,
    )


def skill_with_help(results: ComparedRuns) -> Claim:
    """The order of the methods, where those with a human may ask them."""
    scores = {
        method: _scores(results, method, "assisted_return_mean" if method != "srl" else _ALONE)
        for method in METHODS
    }
    verdict, sure = in_order(scores)
    return Claim(
        "Skill with the human's help",
        "its test phase asks for help",
        f"mean test return, SRL's alone: {SURE_AIM}",
        f"{told(scores, stats.mean, '.1f')}; {sure}",
        verdict,
        results.seeds,
    )


def alarms(results: ComparedRuns) -> Claim:
    """How many falls an alarm came before."""
    falls = warned = 0
    leads: list[float] = []
    for run in results.runs["hitl-ac"]:
        tests = select(run.tests, "mode", "autonomous")
        lead = tests["lead_steps"][tests["fall"] == 1]
        falls += lead.size
        warned += int((~np.isnan(lead)).sum())
        leads += lead[~np.isnan(lead)].tolist()
    seconds = np.median(leads) / STEPS_PER_SECOND if leads else 0.0
    return Claim(
        "Alarms before falls",
        "–",
        "reported: falls in HITL-AC's autonomous tests with an alarm in the last second",
        f"{warned} of {falls} falls"
        + (f"; {seconds:.2f} s before it by the median" if leads else ""),
        "–",
        results.seeds,
    )


def _scores(results: ComparedRuns, method: str, measure: str = _ALONE) -> np.ndarray:
    rows = [summary.summarise_run(run) for run in results.runs[method]]
    return np.array([row[measure] for row in rows], float)
