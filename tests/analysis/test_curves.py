"""Curves of seeds that end at different places."""

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.curves import MAX_POINTS, over_episodes, over_samples, over_seeds, over_steps


def test_each_point_is_over_the_seeds_that_reach_it():
    curves = [np.full(2, 0.0), np.full(5, 10.0), np.full(3, 2.0)]
    curve = over_seeds(np.arange(5), curves, stats.mean)
    # Two of three seeds reach the third point and one the fourth: fewer than half.
    np.testing.assert_array_equal(curve.x, [0, 1, 2])
    np.testing.assert_array_equal(curve.centre, [4.0, 4.0, 6.0])
    # The least of 27 or 4 resamples has probability above 2.5 %: the band is the range.
    np.testing.assert_array_equal(curve.low, [0.0, 0.0, 2.0])
    np.testing.assert_array_equal(curve.high, [10.0, 10.0, 10.0])
    assert curve.seeds == 3
    assert curve.seeds_at.tolist() == [3, 3, 2]


def test_half_of_the_seeds_is_enough():
    curves = [np.zeros(1), np.zeros(4)]
    assert len(over_seeds(np.arange(4), curves, stats.mean).x) == 4


def test_a_seed_without_data_is_counted():
    curves = [np.zeros(0), np.zeros(0), np.zeros(2)]
    curve = over_seeds(np.arange(2), curves, stats.mean)
    assert (len(curve.x), curve.seeds) == (0, 3)


def test_over_episodes_smooths_and_thins():
    curve = over_episodes([np.array([0.0, 2.0, 4.0])], 2)
    np.testing.assert_array_equal(curve.x, [1, 2, 3])
    np.testing.assert_array_equal(curve.centre, [0.0, 1.0, 3.0])
    np.testing.assert_array_equal(curve.low, curve.centre)  # one seed
    long = over_episodes([np.arange(10_000.0)] * 2, 1)
    assert len(long.x) == MAX_POINTS
    assert (long.x[0], long.x[-1]) == (1, 10_000)
    np.testing.assert_array_equal(long.centre, long.x - 1)


def test_over_steps_interpolates_between_ends_of_episodes():
    curve = over_steps([np.array([100.0, 200.0])], [np.array([10.0, 30.0])], 1)
    assert (curve.x[0], curve.x[-1]) == (0.0, 200.0)
    # Until the first end 10, then the line through (100, 10) and (200, 30).
    np.testing.assert_allclose(curve.centre, np.maximum(10.0, 10.0 + 0.2 * (curve.x - 100.0)))


def test_over_samples_is_drawn_where_the_samples_were():
    places = [np.array([1000, 2000, 4000]), np.array([1000, 4000])]
    curve = over_samples(places, [np.array([1.0, np.nan, 4.0]), np.array([1.0, 7.0])])
    np.testing.assert_array_equal(curve.x, [1000, 2000, 4000])
    np.testing.assert_array_equal(curve.centre, [1.0, np.nan, 5.5])
    assert curve.seeds_at.tolist() == [2, 2, 2]
    longer = over_samples([np.arange(10_000) * 3], [np.arange(10_000.0)])
    assert len(longer.x) == MAX_POINTS
    assert (longer.x[0], longer.x[-1], longer.centre[-1]) == (0, 29_997, 9999.0)


def test_nan_stays_nan():
    values = [np.array([1.0, np.nan, 3.0, 4.0]), np.arange(4.0)]
    curve = over_episodes(values, 1)
    for line in (curve.centre, curve.low, curve.high):
        assert np.isnan(line).tolist() == [False, True, False, False]
    steps = [np.array([10.0, 20.0, 30.0, 40.0])] * 2
    curve = over_steps(steps, values, 1)
    assert np.isnan(curve.centre).tolist() == np.isnan(curve.low).tolist()
    assert np.isnan(curve.centre[(curve.x > 10) & (curve.x < 30)]).all()
