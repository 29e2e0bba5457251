"""A claim as a row of the report, and the rules by which numbers decide it.

Each claim is given what the paper says, what must be seen for it to hold here, what was measured,
and a verdict that follows from the last two by a rule.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitl_jax.analysis import stats

MARGIN = 10.0
"""Points of return that do not matter."""

SURE = 0.8
"""Probability of improvement from which a method is called better."""

SURE_AIM = (
    f"probability of improvement, paired by seed, at least {SURE} for each step, its interval "
    "above 0.5"
)
"""What `in_order` asks for, in words."""

HOLDS, HOLDS_NOT, UNDECIDED = "holds", "does not hold", "not decided"


class Claim(NamedTuple):
    """One row of the table.

    Attributes:
        name: in a few words, with the figure.
        paper: what the paper says.
        aim: what must be seen.
        measured: what was.
        verdict: `HOLDS`, `HOLDS_NOT` or `UNDECIDED`; "–" where a number is only reported.
        seeds: S, over which it was measured.
        brief: what was measured, in fewer words; empty where `measured` is brief.
    """

    name: str
    paper: str
    aim: str
    measured: str
    verdict: str
    seeds: int
    brief: str = ""


def of_sign(estimate: stats.Estimate, threshold: float = 0.0) -> str:
    """The verdict on "above a threshold": by the side on which the whole interval lies."""
    if estimate.low > threshold:
        return HOLDS
    return HOLDS_NOT if estimate.high < threshold else UNDECIDED


def in_resamples(holds: np.ndarray, of: Sequence[np.ndarray]) -> tuple[str, str]:
    """A verdict from the share of resamples in which a claim holds, and that share in words.

    Args:
        holds: bool [resamples].
        of: the numbers that were compared, [resamples] each; NaN in one decides nothing.
    """
    share = _share_of(holds, of)
    return _verdict_of(share), f"so in {100 * share:.0f} % of resamples of the seeds"


def _share_of(holds: np.ndarray, of: Sequence[np.ndarray]) -> float:
    """The share of resamples in which a claim holds; NaN if a number that it compares is NaN."""
    return float("nan") if np.isnan(of).any() else float(holds.mean())


def _verdict_of(share: float) -> str:
    """The verdict from such a share; NaN decides nothing."""
    return HOLDS if share >= 0.975 else HOLDS_NOT if share <= 0.025 else UNDECIDED


def in_order(scores: Mapping[str, np.ndarray]) -> tuple[str, str]:
    """The verdict on "HITL-AC above HITL-FIX above SRL", and how sure each step is, in words.

    Args:
        scores: of each method, one for each seed, [S], in the same order; greater is better.
    """
    cells, verdicts = [], []
    for x, y in (("hitl-ac", "hitl-fix"), ("hitl-fix", "srl")):
        p = stats.probability_of_improvement(scores[x], scores[y])
        cells.append(f"{x.upper()} over {y.upper()} {p:.2f}")
        if p.value >= SURE and p.low > 0.5:
            verdicts.append(HOLDS)
        else:
            verdicts.append(HOLDS_NOT if p.high < SURE else UNDECIDED)
    return least(verdicts), ", ".join(cells)


def told(scores: Mapping[str, np.ndarray], statistic: stats.Statistic, spec: str) -> str:
    """A statistic of each method with its interval, in words, the last method first.

    Args:
        scores: of each method, one for each seed, [S].
        statistic: over seeds.
        spec: format of its numbers.
    """
    estimates = {method: stats.estimate(values, statistic) for method, values in scores.items()}
    cells = [f"{method.upper()} {value:{spec}}" for method, value in estimates.items()]
    return ", ".join(reversed(cells))


def least(verdicts: Sequence[str]) -> str:
    """Of several parts of a claim: it holds where all do, and does not where one does not."""
    order = (HOLDS_NOT, UNDECIDED, HOLDS)
    return min(verdicts, key=order.index)
