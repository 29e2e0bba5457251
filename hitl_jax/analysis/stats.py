"""Statistics over seeds: interquartile mean, bootstrap intervals, probability of improvement.

Pure numpy. The seed axis comes first and is called S. Whatever draws at random takes the caller's
`np.random.Generator`. The recommendations followed are those of Agarwal et al. 2021, "Deep
reinforcement learning at the edge of the statistical precipice"
(https://arxiv.org/abs/2108.13264), whose library is rliable.

With one seed there is nothing to resample: an interval is then the point itself, [x, x], and must
be shown as "no interval: one seed", never as certainty.
"""

from collections.abc import Callable

import numpy as np

Statistic = Callable[[np.ndarray, int], np.ndarray]
"""Maps (values, axis) to the values with that axis reduced."""

SEED = 0
"""Of the generators that commands draw intervals from: the same data give the same intervals."""

_CHUNK_ELEMENTS = 2_000_000
"""Elements of resampled values held at once: 16 MB, so that long curves need little memory."""


def mean(x: np.ndarray, axis: int) -> np.ndarray:
    """The arithmetic mean along `axis`."""
    return np.mean(x, axis=axis)


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


def bootstrap_interval(
    values: np.ndarray,
    statistic: Statistic,
    rng: np.random.Generator,
    resamples: int = 2000,
    level: float = 0.95,
) -> tuple[np.ndarray, np.ndarray]:
    """Percentile bootstrap interval of a statistic over seeds.

    A resample draws S seeds with replacement and keeps each seed's curve whole, so the interval is
    pointwise in T and all points share the same resamples.

    Args:
        values: one value a seed, [S], or one curve a seed, [S, T].
        statistic: what is estimated, for example `interquartile_mean`.
        rng: drawn from; the same state gives the same interval.
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
    seeds = values.shape[0]
    drawn = rng.integers(seeds, size=(resamples, seeds))
    quantiles = [(1.0 - level) / 2.0, (1.0 + level) / 2.0]
    if values.ndim == 1:
        low, high = _quantiles(statistic(values[drawn], 1), quantiles, statistic(values, 0))
        return low, high
    # Seeds last, [T, resamples, S], so that the statistic walks through memory in order.
    curves = np.ascontiguousarray(values.T)
    low, high = np.empty(len(curves)), np.empty(len(curves))
    points = max(1, _CHUNK_ELEMENTS // drawn.size)
    for start in range(0, len(curves), points):
        part = slice(start, start + points)
        resampled = statistic(curves[part][:, drawn], 2)
        low[part], high[part] = _quantiles(resampled, quantiles, statistic(curves[part], 1))
    return low, high


def _quantiles(resampled: np.ndarray, quantiles: list[float], of_all: np.ndarray) -> np.ndarray:
    """Quantiles along the last axis; NaN where the statistic of all seeds is, drawn or not."""
    return np.where(np.isnan(of_all), np.nan, np.quantile(resampled, quantiles, axis=-1))


def probability_of_improvement(
    x: np.ndarray,
    y: np.ndarray,
    rng: np.random.Generator,
    resamples: int = 2000,
    level: float = 0.95,
) -> tuple[float, float, float]:
    """How often X beats Y on the same seed: mean(x > y) + ½ mean(x = y).

    Paired by seed, unlike rliable, which compares every run of X with every run of Y: here runs of
    one seed share the terrain of their test, and pairing keeps that.

    Args:
        x: X's score for each seed, [S].
        y: Y's score for the same seeds in the same order, [S].
        rng: drawn from for the interval.
        resamples: number of resamples of the pairs.
        level: coverage, between 0 and 1.

    Returns:
        (probability, low, high). With S = 1 all three are equal. NaN where a score is NaN: it
        neither wins nor loses.

    Raises:
        ValueError: if the shapes differ or there is no pair.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"x {x.shape} and y {y.shape}: must be [S], one score for each seed")
    wins = np.where(np.isnan(x) | np.isnan(y), np.nan, (x > y) + 0.5 * (x == y))
    low, high = bootstrap_interval(wins, mean, rng, resamples, level)
    return float(np.mean(wins)), float(low), float(high)


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
