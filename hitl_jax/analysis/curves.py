"""Learning curves over seeds whose data have different lengths: an estimate and its band.

A seed is called s, of S; its data end where its run does, or where it has got to. Each point of a
curve is over the seeds that reach it, and the curve ends where fewer than half do.
"""

from typing import NamedTuple

import numpy as np

from hitl_jax.analysis import stats

MAX_POINTS = 250
"""Points of a curve: more cannot be seen in a figure."""


class Curve(NamedTuple):
    """A statistic over seeds and its bootstrap 95 % band.

    Attributes:
        x: where, [T].
        centre: the statistic, [T].
        low: the band's lower edge, [T].
        high: the band's upper edge, [T].
        seeds: S; with one seed the band is the curve itself.
        seeds_at: how many of them reach each point, [T].
    """

    x: np.ndarray
    centre: np.ndarray
    low: np.ndarray
    high: np.ndarray
    seeds: int
    seeds_at: np.ndarray


def over_episodes(values: list[np.ndarray], window: int) -> Curve:
    """The interquartile mean over seeds of a trailing mean, over episodes.

    Args:
        values: one for each episode of each seed, S >= 1 arrays [T_s], none of them empty.
        window: episodes in the trailing mean.

    Returns:
        The curve; x counts episodes from 1.
    """
    series = [stats.trailing_mean(y, window) for y in values]
    last = max(map(len, series))
    episodes = np.unique(np.linspace(1, last, min(last, MAX_POINTS)).astype(int))
    reached = [y[episodes[episodes <= len(y)] - 1] for y in series]
    return over_seeds(episodes, reached, stats.interquartile_mean)


def over_steps(steps: list[np.ndarray], values: list[np.ndarray], window: int) -> Curve:
    """The interquartile mean over seeds of a trailing mean, over environment steps.

    Interpolated on a grid from 0; before the end of the first episode its value stands.

    Args:
        steps: for each seed the steps so far at the end of each episode, [T_s].
        values: one for each episode of each seed, [T_s].
        window: episodes in the trailing mean.

    Returns:
        The curve; x is in the unit of `steps`.
    """
    grid = np.linspace(0.0, max(x[-1] for x in steps), MAX_POINTS)
    reached = [
        np.interp(grid[grid <= x[-1]], x, stats.trailing_mean(y, window))
        for x, y in zip(steps, values, strict=True)
    ]
    return over_seeds(grid, reached, stats.interquartile_mean)


def over_samples(places: list[np.ndarray], values: list[np.ndarray]) -> Curve:
    """The interquartile mean over seeds of what was sampled now and then.

    A seed that lacks a sample where another has one is interpolated; before its first sample that
    one's value stands. A value that is NaN makes a gap, as wide as to the samples beside it.

    Args:
        places: of each seed's samples, rising, S >= 1 arrays [K_s], none of them empty.
        values: there, [K_s] each.

    Returns:
        The curve; x is in the unit of `places`.
    """
    grid = np.unique(np.concatenate(places))
    grid = grid[np.linspace(0, len(grid) - 1, min(len(grid), MAX_POINTS)).astype(int)]
    reached = [np.interp(grid[grid <= x[-1]], x, y) for x, y in zip(places, values, strict=True)]
    return over_seeds(grid, reached, stats.interquartile_mean)


def over_seeds(
    x: np.ndarray,
    curves: list[np.ndarray],
    statistic: stats.Statistic,
) -> Curve:
    """A statistic over seeds whose curves are beginnings, of different lengths, of one grid.

    Args:
        x: the grid, [T].
        curves: one for each seed, [T_s] with T_s <= T.
        statistic: over seeds.

    Returns:
        The curve as far as half of the seeds reach.
    """
    lengths = np.array([len(curve) for curve in curves])
    end = np.sort(lengths)[len(lengths) // 2]
    centre, low, high = (np.empty(end) for _ in range(3))
    seeds_at = (lengths > np.arange(end)[:, None]).sum(1)
    start = 0
    # Between two consecutive lengths the seeds that have data are the same.
    for stop in np.unique(np.minimum(lengths, end)):
        part = slice(start, stop)
        values = np.stack([curve[part] for curve in curves if len(curve) >= stop])
        centre[part] = statistic(values, 0)
        low[part], high[part] = stats.bootstrap_interval(values, statistic)
        start = stop
    return Curve(x[:end], centre, low, high, len(curves), seeds_at)
