"""Claims about training: its speed, the boundary, and the human's work."""

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.summary import WINDOW, steps_at
from hitl_jax.analysis.verdicts import HOLDS, HOLDS_NOT, UNDECIDED, Claim, in_resamples, of_sign
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import Run

WALKS = 200.0
"""A return that only a walker gets that walks well."""
_EARLY = 400
"""The paper's episode at which HITL-AC improves."""
_NEAR = 0.05
"""Of the human's threshold, at the end of training [rad]."""
_SETTLED = 0.03
"""Of the human's threshold, for good [rad]."""
_EDGE = 0.05
"""Of the bounds' distance: nearer to one of them than this a boundary has run to it."""
_MOST_SEEDS = 0.9
_LAST = 20
"""Episodes at the end of training, over which a boundary is averaged: one state's says little."""


def speed(results: ComparedRuns) -> Claim:
    """Figure 4: the episode at which a method's curve passes a return."""
    drawn = results.resampled()
    passages, cells = [], []
    for method in METHODS:
        curves = np.array([_trailing_returns(run) for run in results.runs[method]])
        passages.append(np.array([_passage(curves[seeds]) for seeds in drawn]))
        ends = (_passage(curves), *stats.interval_of(passages[-1]))
        cells.append(_cell(method, [_episode(float(end)) for end in ends]))
    srl, fix, ac = passages
    verdict, share = in_resamples((ac <= _EARLY) & (ac < fix) & (fix < srl), passages)
    return Claim(
        "Training speed (Figure 4)",
        "HITL-AC improves near episode 400, HITL-FIX after 500, SRL is very poor for 800",
        f"the interquartile mean of HITL-AC's trailing-{WINDOW} returns passes {WALKS:.0f} by "
        f"episode {_EARLY}, HITL-FIX's after it, SRL's after both",
        f"episode: {', '.join(reversed(cells))}; {share}",
        verdict,
        results.seeds,
    )


def speed_in_steps(results: ComparedRuns) -> Claim:
    """The same over environment steps: a human who resets early shortens episodes."""
    drawn = results.resampled()
    medians, cells = {}, []
    for method in METHODS:
        steps = np.array([_steps_until_it_walks(run) for run in results.runs[method]])
        medians[method] = stats.median(steps[drawn], 1)
        median = stats.estimate(steps, stats.median)
        cells.append(_cell(method, [thousands(end) for end in median[:3]]))
    earlier = medians["hitl-ac"] < medians["srl"]
    verdict, share = in_resamples(earlier, list(medians.values()))
    return Claim(
        "Training speed over environment steps",
        "–",
        f"the median step at which a seed's trailing-{WINDOW} return passes {WALKS:.0f} is "
        "earlier for HITL-AC than for SRL",
        f"thousands of steps: {', '.join(reversed(cells))}; {share}",
        verdict,
        results.seeds,
    )


def boundary(results: ComparedRuns) -> Claim:
    """Figure 6: where each seed's boundary ends."""
    if results.tolerance is None:
        return _within_bounds(results)
    return _at_the_threshold(results, results.tolerance)


def mean_boundary(run: Run) -> float:
    """Mean of the executed boundary over a run's last episodes; NaN if none had one."""
    means = run.episodes["mean_boundary"][-_LAST:]
    means = means[~np.isnan(means)]
    return means.mean().item() if means.size else np.nan


def _within_bounds(results: ComparedRuns) -> Claim:
    """A human who goes by no angle has no threshold: the boundary must run to neither bound."""
    low, high = results.bounds
    edge = _EDGE * (high - low)
    ends = np.array([mean_boundary(run) for run in results.runs["hitl-ac"]])
    inside = (ends > low + edge) & (ends < high - edge)
    known = ends[~np.isnan(ends)]
    told = f"from {known.min():.3f} to {known.max():.3f}" if known.size else "of no known boundary"
    return Claim(
        "The boundary (Figure 6)",
        "a learned trend beside the reward",
        f"for at least nine of ten seeds, the mean of the last {_LAST} episodes is more than "
        f"{edge:g} away from both bounds, {low:g} and {high:g}",
        f"{inside.sum()} of {inside.size} seeds, {told}",
        UNDECIDED if np.isnan(ends).any() else HOLDS if inside.mean() >= _MOST_SEEDS else HOLDS_NOT,
        results.seeds,
    )


def _at_the_threshold(results: ComparedRuns, threshold: float) -> Claim:
    """Where each seed's boundary ends, and from when on it stays near the human's threshold."""
    ends, settled = [], []
    for run in results.runs["hitl-ac"]:
        trace = run.episodes["final_boundary"]
        ends.append(trace[-1])
        away = np.flatnonzero(~(np.abs(trace - threshold) <= _SETTLED))  # NaN is away.
        settled.append(away[-1] + 2.0 if away.size else 1.0)
        if settled[-1] > len(trace):
            settled[-1] = np.inf
    near = np.abs(np.array(ends) - threshold) <= _NEAR
    least, most = np.min(ends), np.max(ends)
    return Claim(
        "The boundary (Figure 6)",
        "a learned trend beside the reward",
        f"for every seed, within {_NEAR} rad of the human's own threshold of "
        f"{threshold:g} rad at the end of training",
        f"{near.sum()} of {near.size} seeds, from {least:.3f} to {most:.3f} rad; within "
        f"{_SETTLED} rad for good from episode {_episode(np.median(settled))} on by the median "
        f"({_episode(min(settled))} to {_episode(max(settled))})",
        UNDECIDED if np.isnan(ends).any() else HOLDS if near.all() else HOLDS_NOT,
        results.seeds,
    )


def interventions(results: ComparedRuns) -> Claim:
    """Whether the human has less to do at the end of HITL-AC's training."""
    fifths = []
    for run in results.runs["hitl-ac"]:
        work = run.episodes["interventions"]
        part = max(len(work) // 5, 1)
        fifths.append((work[:part].mean(), work[-part:].mean()))
    first, last = np.array(fifths).T
    less = stats.estimate(first - last, stats.mean)
    return Claim(
        "The human's work falls",
        "–",
        "fewer interventions an episode in the last fifth of HITL-AC's training than in the first",
        f"{first.mean():.2f} an episode, then {last.mean():.2f}; difference {less:.2f}",
        of_sign(less),
        results.seeds,
    )


def _trailing_returns(run: Run) -> np.ndarray:
    """Mean of the last returns at each training episode, [T]."""
    return stats.trailing_mean(run.episodes["return"], WINDOW)


def _steps_until_it_walks(run: Run) -> float:
    episode = stats.first_passage(_trailing_returns(run), WALKS, WINDOW)
    steps = steps_at(run.episodes, episode)
    return np.inf if steps is None else float(steps)


def _passage(curves: np.ndarray) -> float:
    """The episode at which the interquartile mean of curves [S, T] passes; infinite for never."""
    centre = stats.interquartile_mean(curves, 0)
    episode = stats.first_passage(centre, WALKS, WINDOW)
    return np.inf if episode is None else float(episode)


def _cell(method: str, ends: list[str]) -> str:
    value, low, high = ends
    return f"{method.upper()} {value} [{low}, {high}]"


def _episode(passage: float) -> str:
    return "never" if np.isinf(passage) else f"{passage:.0f}"


def thousands(steps: float) -> str:
    """Environment steps in words; infinite for never."""
    return "never" if np.isinf(steps) else f"{steps / 1000:.0f}"
