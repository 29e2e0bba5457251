"""Statistics over seeds: interquartile mean, bootstrap intervals, probability of improvement.

Pure numpy. The seed axis comes first and is called S. The recommendations followed are those of
Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice"
(https://arxiv.org/abs/2108.13264), whose library is rliable.

All intervals come from `resampled_seeds`, which draws the same resamples each time. So the same
values have the same interval in every table, report and figure, and methods that have the same
seeds are resampled together.

With one seed there is nothing to resample: an interval is then the point itself, [x, x], and must
be shown as "no interval: one seed", never as certainty.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Statistic = Callable[[np.ndarray, int], np.ndarray]
"""Maps (values, axis) to the values with that axis reduced."""

SEED = 0
"""Of the generator that draws all resamples."""

RESAMPLES = 2000
LEVEL = 0.95
"""Coverage of an interval."""

_CHUNK_ELEMENTS = 2_000_000
"""Elements of resampled values held at once: 16 MB, so that long curves need little memory."""


def mean(x: np.ndarray, axis: int) -> np.ndarray:
    """The arithmetic mean along `axis`."""
    return np.mean(x, axis=axis)


def median(x: np.ndarray, axis: int) -> np.ndarray:
    """The median along `axis`; infinite if one of two values in the middle is."""
    return np.median(x, axis=axis)


def interquartile_mean(x: np.ndarray, axis: int) -> np.ndarray:
    """The 25 % trimmed mean: the mean of what is left without the ⌊n/4⌋ least and greatest.

    The convention of `scipy.stats.trim_mean(x, 0.25)`, and so of rliable's `aggregate_iqm`: whole
    values are cut and the count is rounded down, with no fractional weights. Of 10 seeds the middle
    six are left; with fewer than four it is the plain mean.

    Args:
        x: values; the length n of `axis` is at least 1.
        axis: the axis to reduce.

    Returns:
        `x` without `axis`. NaN wherever a value is NaN: sorting would put it last, and the cut
        would hide it.
    """
    x = np.sort(np.moveaxis(np.asarray(x, dtype=float), axis, -1), axis=-1)
    count = x.shape[-1]
    cut = count // 4
    middle = np.mean(x[..., cut : count - cut], axis=-1)
    return np.where(np.isnan(x[..., -1]), np.nan, middle)


class Estimate(NamedTuple):
    """A statistic over seeds with its bootstrap 95 % interval.

    `f"{estimate:.1f}"` is "3.0 [2.1, 4.2]", and "3.0" where there is one seed.

    Attributes:
        value: the statistic of all seeds.
        low: lower end of the interval.
        high: upper end of the interval.
        seeds: S; with one seed both ends are the value.
    """

    value: float
    low: float
    high: float
    seeds: int

    def __format__(self, spec: str) -> str:
        value, low, high = (format(number, spec) for number in self[:3])
        return f"{value} [{low}, {high}]" if self.seeds > 1 else value


def estimate(values: np.ndarray, statistic: Statistic) -> Estimate:
    """A statistic over seeds with its interval.

    Args:
        values: one value for each seed, [S].
        statistic: what is estimated, for example `interquartile_mean`.

    Raises:
        ValueError: if there is no seed.
    """
    low, high = bootstrap_interval(values, statistic)
    return Estimate(float(statistic(values, 0)), float(low), float(high), len(values))


def resampled_seeds(seeds: int, resamples: int = RESAMPLES) -> np.ndarray:
    """Which seeds each resample holds: S of S, drawn with replacement, the same at each call.

    Args:
        seeds: S.
        resamples: number of resamples.

    Returns:
        Indices of seeds, [resamples, S].
    """
    return np.random.default_rng(SEED).integers(seeds, size=(resamples, seeds))


def interval_of(resampled: np.ndarray, level: float = LEVEL) -> tuple[np.ndarray, np.ndarray]:
    """The percentile interval of a statistic.

    Its ends are values of resamples, with nothing interpolated: some can be infinite, where an
    event never happens.

    Args:
        resampled: the statistic of each resample, [..., resamples].
        level: coverage, between 0 and 1.

    Returns:
        (low, high), each [...]; NaN where a resample is NaN.
    """
    return (
        np.quantile(resampled, (1.0 - level) / 2.0, axis=-1, method="lower"),
        np.quantile(resampled, (1.0 + level) / 2.0, axis=-1, method="higher"),
    )


def bootstrap_interval(
    values: np.ndarray,
    statistic: Statistic,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
) -> tuple[np.ndarray, np.ndarray]:
    """Percentile bootstrap interval of a statistic over seeds.

    A resample draws S seeds with replacement and keeps each seed's curve whole, so the interval is
    pointwise in T and all points share the same resamples.

    Args:
        values: one value a seed, [S], or one curve a seed, [S, T].
        statistic: what is estimated, for example `interquartile_mean`.
        resamples: number of resamples.
        level: coverage, between 0 and 1.

    Returns:
        (low, high), each [] or [T]. With S = 1 both equal the statistic itself; NaN where that is.

    Raises:
        ValueError: if there is no seed, or an axis too many.
    """
    values = np.asarray(values, dtype=float)
    if values.ndim not in (1, 2) or values.shape[0] == 0:
        raise ValueError(f"values have shape {values.shape}: must be [S] or [S, T] with S >= 1")
    drawn = resampled_seeds(len(values), resamples)
    # Seeds last, [T, resamples, S], so that the statistic walks through memory in order.
    curves = np.ascontiguousarray(values.reshape(len(values), -1).T)
    low, high = np.empty(len(curves)), np.empty(len(curves))
    points = max(1, _CHUNK_ELEMENTS // drawn.size)
    for start in range(0, len(curves), points):
        part = slice(start, start + points)
        low[part], high[part] = interval_of(statistic(curves[part][:, drawn], 2), level)
    # NaN where the statistic of all seeds is, whether that seed was drawn or not.
    lost = np.isnan(statistic(curves, 1))
    low[lost] = high[lost] = np.nan
    shape = values.shape[1:]
    return low.reshape(shape)[()], high.reshape(shape)[()]


def probability_of_improvement(x: np.ndarray, y: np.ndarray) -> Estimate:
    """How often X beats Y on the same seed: mean(x > y) + ½ mean(x = y).

    Paired by seed, unlike rliable, which compares every run of X with every run of Y: here runs of
    one seed share the terrain of their test, and pairing keeps that.

    Args:
        x: X's score for each seed, [S].
        y: Y's score for the same seeds in the same order, [S].

    Returns:
        The probability with its interval. NaN where a score is NaN: it neither wins nor loses.

    Raises:
        ValueError: if the shapes differ or there is no pair.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"x {x.shape} and y {y.shape}: must be [S], one score for each seed")
    wins = np.where(np.isnan(x) | np.isnan(y), np.nan, (x > y) + 0.5 * (x == y))
    return estimate(wins, mean)


def trailing_mean(x: np.ndarray, window: int) -> np.ndarray:
    """The mean of the last `window` values up to and including each one.

    Args:
        x: one value an episode, [T].
        window: number of values, at least 1; the first values average over what there is.

    Returns:
        [T].

    Raises:
        ValueError: if the window is not positive.
    """
    if window < 1:
        raise ValueError(f"window {window}: must be at least 1")
    x = np.asarray(x, dtype=float)
    head = x[: window - 1]
    start = np.cumsum(head) / np.arange(1, len(head) + 1)
    if len(x) < window:
        return start
    # Each window is summed afresh: a running sum would carry rounding, and any NaN, along.
    full = np.lib.stride_tricks.sliding_window_view(x, window).mean(axis=-1)
    return np.concatenate([start, full])


def first_passage(trailing: np.ndarray, threshold: float, window: int) -> float | None:
    """The first episode, counted from 1, at which the trailing mean reaches a threshold.

    Args:
        trailing: `trailing_mean(returns, window)`, [T].
        threshold: return to reach; equality counts.
        window: the window of `trailing`; episodes before it is full do not count, since one lucky
            first episode would.

    Returns:
        The episode, a whole number, or None if it never happens; NaN if a mean before it is NaN,
        which may have reached the threshold.
    """
    full = np.asarray(trailing)[window - 1 :]
    reached = np.flatnonzero((full >= threshold) | np.isnan(full))
    if not reached.size:
        return None
    return float("nan") if np.isnan(full[reached[0]]) else int(reached[0]) + window
