"""The paper's claims, one by one, against a folder of results.

Each claim is given what the paper says, what must be seen for it to hold here, what was measured,
and a verdict that follows from the two by a rule; nobody's opinion comes between.
"""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.summary import (
    STEPS_PER_SECOND,
    WINDOW,
    skill_over_training,
    steps_at,
    summarise_run,
)
from hitl_jax.results.episode_tables import METHODS, select
from hitl_jax.results.folder import Run

RESAMPLES = 2000
_WALKS = 200.0  # A return that only a walker gets that walks well.
_GOOD = 300.0
_EARLY = 400  # The paper's episode at which HITL-AC improves.
_NEAR = 0.05  # rad
_SETTLED = 0.03  # rad
_SURE = 0.8
MARGIN = 10.0  # Points of return that do not matter.
MIN_SEEDS = 5  # With fewer an interval is too narrow to decide anything.

HOLDS, HOLDS_NOT, UNDECIDED = "holds", "does not hold", "not decided"


class Claim(NamedTuple):
    """One row of the table.

    Attributes:
        name: in a few words, with the figure.
        paper: what the paper says.
        aim: what must be seen.
        measured: what was.
        verdict: `HOLDS`, `HOLDS_NOT` or `UNDECIDED`.
    """

    name: str
    paper: str
    aim: str
    measured: str
    verdict: str


class Results(NamedTuple):
    """The runs of one learner.

    Attributes:
        runs: finished runs by method.
        tolerance: hull angle from which the human sees danger [rad].
    """

    runs: dict[str, list[Run]]
    tolerance: float


def judge(results: Results) -> list[Claim]:
    """All claims that a folder with the three methods can answer.

    Only seeds count that all three methods have finished.

    Raises:
        ValueError: if there are fewer than `MIN_SEEDS` of them.
    """
    by_seed = [{run.key.seed: run for run in results.runs.get(method, [])} for method in METHODS]
    common = sorted(set.intersection(*map(set, by_seed)))
    if len(common) < MIN_SEEDS:
        raise ValueError(f"{len(common)} seeds done in all methods, of at least {MIN_SEEDS}")
    runs = [[of[seed] for seed in common] for of in by_seed]
    results = results._replace(runs=dict(zip(METHODS, runs, strict=True)))
    claims: list[Callable[[Results, np.random.Generator], Claim | None]] = [
        _speed,
        _economy,
        _skill,
        _progress,
        _improvement,
        _boundary,
        _burden,
        _assistance,
        _foresight,
    ]
    judged = (claim(results, np.random.default_rng(stats.SEED)) for claim in claims)
    return [claim for claim in judged if claim is not None]


def _speed(results: Results, rng: np.random.Generator) -> Claim:
    drawn = _resamples(results, rng)
    passages, cells = [], []
    for method in METHODS:
        curves = np.array([_trailing_returns(run) for run in results.runs[method]])
        centre = _passage(curves)
        passages.append(np.array([_passage(curves[seeds]) for seeds in drawn]))
        # No interpolation: "never" is infinite.
        low = np.quantile(passages[-1], 0.025, method="lower")
        high = np.quantile(passages[-1], 0.975, method="higher")
        cells.append(f"{method.upper()} {_episode(centre)} [{_episode(low)}, {_episode(high)}]")
    srl, fix, ac = passages
    verdict, share = _in_resamples((ac <= _EARLY) & (ac < fix) & (fix < srl), passages)
    return Claim(
        "Training speed (Figure 4)",
        "HITL-AC improves near episode 400, HITL-FIX after 500, SRL is very poor for 800",
        f"the interquartile mean of HITL-AC's trailing-{WINDOW} returns passes {_WALKS:.0f} by "
        f"episode {_EARLY}, HITL-FIX's after it, SRL's after both",
        f"episode: {', '.join(reversed(cells))}; {share}",
        verdict,
    )


def _economy(results: Results, rng: np.random.Generator) -> Claim:
    """A human who resets early shortens episodes: the same speed in the learner's own currency."""
    drawn = _resamples(results, rng)
    medians, cells = {}, []
    for method in METHODS:
        steps = np.array([_steps_until_it_walks(run) for run in results.runs[method]])
        # The upper one of two in the middle: "never" is infinite, and has no middle.
        median = functools.partial(np.quantile, q=0.5, method="higher")
        medians[method] = median(steps[drawn], axis=1)
        low = np.quantile(medians[method], 0.025, method="lower")
        high = np.quantile(medians[method], 0.975, method="higher")
        cells.append(
            f"{method.upper()} {_thousands(median(steps))} [{_thousands(low)}, {_thousands(high)}]"
        )
    earlier = medians["hitl-ac"] < medians["srl"]
    verdict, share = _in_resamples(earlier, list(medians.values()))
    return Claim(
        "Training speed over environment steps",
        "–",
        f"the median step at which a seed's trailing-{WINDOW} return passes {_WALKS:.0f} is "
        "earlier for HITL-AC than for SRL",
        f"thousands of steps: {', '.join(reversed(cells))}; {share}",
        verdict,
    )


def _skill(results: Results, rng: np.random.Generator) -> Claim:
    drawn = _resamples(results, rng)
    centres, cells = [], []
    for method in METHODS:
        scores = _scores(results, method)
        centre = float(stats.interquartile_mean(scores, 0))
        centres.append(stats.interquartile_mean(scores[drawn], 1))
        low, high = np.quantile(centres[-1], [0.025, 0.975])
        mean_low, mean_high = np.quantile(scores[drawn].mean(1), [0.025, 0.975])
        cells.append(
            f"{method.upper()} {centre:.0f} [{low:.0f}, {high:.0f}] "
            f"(mean {scores.mean():.0f} [{mean_low:.0f}, {mean_high:.0f}])"
        )
    srl, fix, ac = centres
    verdict, share = _in_resamples((ac >= _GOOD) & (ac > fix) & (fix > srl), centres)
    return Claim(
        "Skill without the human (Figure 5)",
        "over 100 test episodes HITL-AC 279.7, HITL-FIX 260.5, SRL below",
        f"interquartile means of the autonomous test return: HITL-AC's at least {_GOOD:.0f} and "
        "above that of HITL-FIX with the same τ_0, and HITL-FIX's above SRL's",
        f"{', '.join(reversed(cells))}; {share}",
        verdict,
    )


def _progress(results: Results, rng: np.random.Generator) -> Claim | None:
    """None where no run was tested during training."""
    tested: dict[int, list[str]] = {}
    for method in reversed(METHODS):
        runs = [run for run in results.runs[method] if len(run.progress["trained"])]
        if not runs:
            continue
        points, returns = zip(*map(skill_over_training, runs), strict=True)
        scores = np.array(returns)
        low, high = stats.bootstrap_interval(scores, stats.interquartile_mean, rng)
        for at, point in enumerate(points[0]):
            centre = stats.interquartile_mean(scores[:, at], 0)
            cell = f"{method.upper()} {centre:.0f} [{low[at]:.0f}, {high[at]:.0f}]"
            tested.setdefault(int(point), []).append(cell)
        episodes = int(runs[0].progress["episode"].max())
    if not tested:
        return None
    return Claim(
        "Skill over training",
        "–",
        "reported: interquartile mean of the autonomous test return at points of training, over "
        f"the same {episodes} test episodes of a run at each",
        "; ".join(f"episode {point}: {', '.join(cells)}" for point, cells in tested.items()),
        "–",
    )


def _improvement(results: Results, rng: np.random.Generator) -> Claim:
    cells, verdicts = [], []
    for x, y in (("hitl-ac", "hitl-fix"), ("hitl-fix", "srl")):
        better, worse = _scores(results, x), _scores(results, y)
        p, low, high = stats.probability_of_improvement(better, worse, rng)
        cells.append(f"{x.upper()} over {y.upper()} {p:.2f} [{low:.2f}, {high:.2f}]")
        if p >= _SURE and low > 0.5:
            verdicts.append(HOLDS)
        else:
            verdicts.append(HOLDS_NOT if high < _SURE else UNDECIDED)
    return Claim(
        "How sure that order is",
        "one run of each method",
        f"probability of improvement, paired by seed, at least {_SURE} for each step, its interval "
        "above 0.5",
        ", ".join(cells),
        _least(verdicts),
    )


def _boundary(results: Results, rng: np.random.Generator) -> Claim:
    del rng
    ends, settled = [], []
    for run in results.runs["hitl-ac"]:
        trace = run.episodes["final_boundary"]
        ends.append(trace[-1])
        away = np.flatnonzero(~(np.abs(trace - results.tolerance) <= _SETTLED))  # NaN is away.
        settled.append(away[-1] + 2.0 if away.size else 1.0)
        if settled[-1] > len(trace):
            settled[-1] = np.inf
    near = np.abs(np.array(ends) - results.tolerance) <= _NEAR
    least, most = np.min(ends), np.max(ends)
    return Claim(
        "The boundary (Figure 6)",
        "a learned trend beside the reward",
        f"for every seed, within {_NEAR} rad of the human's own threshold of "
        f"{results.tolerance:g} rad at the end of training",
        f"{near.sum()} of {near.size} seeds, from {least:.3f} to {most:.3f} rad; within "
        f"{_SETTLED} rad for good from episode {_episode(np.median(settled))} on by the median "
        f"({_episode(min(settled))} to {_episode(max(settled))})",
        UNDECIDED if np.isnan(ends).any() else HOLDS if near.all() else HOLDS_NOT,
    )


def _burden(results: Results, rng: np.random.Generator) -> Claim:
    ratios = []
    for run in results.runs["hitl-ac"]:
        work = run.episodes["interventions"]
        part = max(len(work) // 5, 1)
        ratios.append((work[:part].mean(), work[-part:].mean()))
    first, last = np.array(ratios).T
    low, high = stats.bootstrap_interval(first - last, stats.mean, rng)
    return Claim(
        "The human's work falls",
        "–",
        "fewer interventions an episode in the last fifth of HITL-AC's training than in the first",
        f"{first.mean():.2f} an episode, then {last.mean():.2f}; difference "
        f"{(first - last).mean():.2f} [{low:.2f}, {high:.2f}]",
        HOLDS if low > 0 else HOLDS_NOT if high < 0 else UNDECIDED,
    )


def _assistance(results: Results, rng: np.random.Generator) -> Claim:
    gains = []
    for run in results.runs["hitl-ac"]:
        alone, helped = (
            select(run.tests, "mode", mode)["return"].mean() for mode in ("autonomous", "assisted")
        )
        gains.append(helped - alone)
    gain = np.array(gains)
    low, high = stats.bootstrap_interval(gain, stats.mean, rng)
    return Claim(
        "Help in the test",
        "the boundary guides the agent to seek the human's intervention",
        f"HITL-AC's mean assisted test return more than {MARGIN:.0f} above its autonomous one",
        f"{gain.mean():+.1f} [{low:+.1f}, {high:+.1f}]; above it by more than 1 in "
        f"{(gain > 1).sum()} of {gain.size} seeds",
        HOLDS if low > MARGIN else HOLDS_NOT if high < MARGIN else UNDECIDED,
    )


def _foresight(results: Results, rng: np.random.Generator) -> Claim:
    del rng
    falls = warned = 0
    leads: list[float] = []
    for run in results.runs["hitl-ac"]:
        tests = select(run.tests, "mode", "autonomous")
        lead = tests["lead_steps"][tests["fall"] == 1]
        falls += lead.size
        warned += int((~np.isnan(lead)).sum())
        leads += lead[~np.isnan(lead)].tolist()
    time = f"; {np.median(leads) / STEPS_PER_SECOND:.2f} s before it by the median" if leads else ""
    return Claim(
        "Alarms before falls",
        "–",
        "reported: falls in HITL-AC's autonomous tests with an alarm in the last second",
        f"{warned} of {falls} falls{time}",
        "–",
    )


def _trailing_returns(run: Run) -> np.ndarray:
    """Mean of the last returns at each training episode, [T]."""
    return stats.trailing_mean(run.episodes["return"], WINDOW)


def _steps_until_it_walks(run: Run) -> float:
    episode = stats.first_passage(_trailing_returns(run), _WALKS, WINDOW)
    steps = steps_at(run.episodes, episode)
    return np.inf if steps is None else float(steps)


def _passage(curves: np.ndarray) -> float:
    """The episode at which the interquartile mean of curves [S, T] passes; infinite for never."""
    centre = stats.interquartile_mean(curves, 0)
    episode = stats.first_passage(centre, _WALKS, WINDOW)
    return np.inf if episode is None else float(episode)


def _resamples(results: Results, rng: np.random.Generator) -> np.ndarray:
    """Seeds drawn with replacement, the same for all methods, [resamples, S]."""
    seeds = len(results.runs[METHODS[0]])
    return rng.integers(seeds, size=(RESAMPLES, seeds))


def _in_resamples(holds: np.ndarray, of: Sequence[np.ndarray]) -> tuple[str, str]:
    """A verdict from the share of resamples in which a claim holds, and that share in words.

    Args:
        holds: bool [resamples].
        of: the numbers that were compared, [resamples] each; NaN in one decides nothing.
    """
    share = share_of(holds, of)
    return verdict_of(share), f"so in {100 * share:.0f} % of resamples of the seeds"


def share_of(holds: np.ndarray, of: Sequence[np.ndarray]) -> float:
    """The share of resamples in which a claim holds; NaN if a number that it compares is NaN."""
    return float("nan") if np.isnan(of).any() else float(holds.mean())


def verdict_of(share: float) -> str:
    """What such a share says; NaN decides nothing."""
    return HOLDS if share >= 0.975 else HOLDS_NOT if share <= 0.025 else UNDECIDED


def _episode(passage: float) -> str:
    return "never" if np.isinf(passage) else f"{passage:.0f}"


def _thousands(steps: float) -> str:
    return "never" if np.isinf(steps) else f"{steps / 1000:.0f}"


def _scores(results: Results, method: str) -> np.ndarray:
    rows = [summarise_run(run) for run in results.runs[method]]
    return np.array([row["test_return_mean"] for row in rows], float)


def _least(verdicts: list[str]) -> str:
    order = (HOLDS_NOT, UNDECIDED, HOLDS)
    return min(verdicts, key=order.index)
