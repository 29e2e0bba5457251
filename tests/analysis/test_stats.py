"""Statistics against values worked by hand, and against rliable where it is installed."""

import numpy as np
import pytest

from hitl_jax.analysis.stats import (
    RESAMPLES,
    bootstrap_interval,
    estimate,
    first_passage,
    interquartile_mean,
    interval_of,
    mean,
    median,
    probability_of_improvement,
    resampled_seeds,
    trailing_mean,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_interquartile_mean_by_hand():
    # Eight values: ⌊8/4⌋ = 2 are cut at each end, leaving 3, 4, 5, 6: mean 18/4.
    assert interquartile_mean(np.array([100.0, 2, 3, 4, 5, 6, 7, -100]), 0) == 4.5
    # Ten: ⌊10/4⌋ = 2 (2.5 rounded down), leaving 3 … 8: mean 5.5. A mean would be 104.5.
    assert interquartile_mean(np.array([1.0, 2, 3, 4, 5, 6, 7, 8, 9, 1000]), 0) == 5.5
    # Three: nothing to cut.
    assert interquartile_mean(np.array([0.0, 0.0, 3.0]), 0) == 1.0
    assert interquartile_mean(np.array([7.0]), 0) == 7.0


def test_interquartile_mean_reduces_the_named_axis():
    x = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0], [9.0, 90.0]])
    # Columns: 1 2 3 9 -> (2 + 3) / 2; the second is ten times the first. Rows: plain means.
    np.testing.assert_array_equal(interquartile_mean(x, 0), [2.5, 25.0])
    np.testing.assert_array_equal(interquartile_mean(x, 1), [5.5, 11.0, 16.5, 49.5])


def test_interquartile_mean_does_not_hide_nan():
    # Sorted last, the NaN would be among the cut values.
    assert np.isnan(interquartile_mean(np.array([1.0, 2.0, 3.0, np.nan]), 0))


def test_interquartile_mean_is_rliables():
    metrics = pytest.importorskip("rliable.metrics")
    for seeds in (1, 3, 5, 10, 13):
        scores = rng().normal(size=(seeds, 1))
        np.testing.assert_allclose(
            interquartile_mean(scores[:, 0], 0), metrics.aggregate_iqm(scores), rtol=1e-12
        )


def test_bootstrap_interval_of_two_seeds():
    # Resamples of {0, 1} have mean 0, ½ or 1 with probability ¼, ½, ¼: the 2.5 % and 97.5 %
    # quantiles are 0 and 1, the 30 % and 70 % quantiles both ½.
    values = np.array([0.0, 1.0])
    assert bootstrap_interval(values, mean) == (0.0, 1.0)
    assert bootstrap_interval(values, mean, level=0.4) == (0.5, 0.5)


def test_bootstrap_interval_has_the_width_of_theory():
    # The mean of n normals: ±1.96 s/√n. With 2000 resamples the ends are known to a few per cent.
    values = rng().normal(10.0, 2.0, size=400)
    low, high = bootstrap_interval(values, mean)
    half = 1.96 * values.std() / 20.0
    assert low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert high == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_bootstrap_interval_of_curves_is_that_of_each_point(monkeypatch):
    curves = rng().normal(size=(5, 7))
    # A small chunk, so that the loop runs more than once: 3 points of 100 × 5 draws.
    monkeypatch.setattr("hitl_jax.analysis.stats._CHUNK_ELEMENTS", 3 * 100 * 5)
    low, high = bootstrap_interval(curves, interquartile_mean, resamples=100)
    assert low.shape == high.shape == (7,)
    for t in range(7):
        point = bootstrap_interval(curves[:, t], interquartile_mean, resamples=100)
        assert (low[t], high[t]) == pytest.approx(point)


def test_the_same_values_have_the_same_interval():
    values = rng().normal(size=7)
    one = estimate(values, mean)
    bootstrap_interval(rng().normal(size=(4, 3)), mean)  # changes nothing of what follows
    assert estimate(values, mean) == one
    curves = np.column_stack([np.zeros(7), values])
    low, high = bootstrap_interval(curves, mean)
    assert (low[1], high[1]) == one[1:3]  # to the last bit, in a curve too
    drawn = interval_of(mean(values[resampled_seeds(7)], 1))
    assert drawn == one[1:3]
    assert resampled_seeds(7).shape == (RESAMPLES, 7)


def test_an_interval_can_reach_to_never():
    # Two of four seeds never get there: the median is infinite in more than 2.5 % of resamples.
    steps = np.array([1.0, 2.0, np.inf, np.inf])
    assert estimate(steps, median) == (np.inf, 1.0, np.inf, 4)


def test_an_estimate_in_words():
    assert f"{estimate(np.array([0.0, 10.0]), mean):+,.1f}" == "+5.0 [+0.0, +10.0]"
    assert f"{estimate(np.array([1234.5]), mean):,.1f}" == "1,234.5"


def test_one_seed_gives_the_point():
    assert bootstrap_interval(np.array([3.0]), interquartile_mean) == (3.0, 3.0)
    low, high = bootstrap_interval(np.array([[1.0, 2.0]]), interquartile_mean)
    np.testing.assert_array_equal(low, [1.0, 2.0])
    np.testing.assert_array_equal(high, [1.0, 2.0])


def test_no_seed_is_refused():
    with pytest.raises(ValueError, match=r"shape \(0,\)"):
        bootstrap_interval(np.array([]), mean)


def test_probability_of_improvement_by_hand():
    # Two wins, one tie, one loss of four: (2 + ½) / 4.
    p, low, high, seeds = probability_of_improvement(
        np.array([3.0, 5.0, 1.0, 0.0]), np.array([1.0, 4.0, 1.0, 9.0])
    )
    assert p == 0.625
    assert 0.0 <= low < p < high <= 1.0
    assert seeds == 4
    # A win on every seed cannot be resampled into anything else.
    assert probability_of_improvement(np.arange(3) + 1, np.arange(3)) == (1.0, 1.0, 1.0, 3)


def test_probability_of_improvement_is_paired():
    # y beats x by 1 on each seed, which unpaired scores would not show: the spread is 100.
    x = np.array([0.0, 100.0, 200.0])
    assert probability_of_improvement(x, x + 1.0)[0] == 0.0
    with pytest.raises(ValueError, match="one score for each seed"):
        probability_of_improvement(x, x[:2])


def test_probability_of_improvement_is_rliables_where_pairing_cannot_matter():
    metrics = pytest.importorskip("rliable.metrics")
    # Every x beats every y but for one value of x below all y: 3 of 4 either way.
    x, y = np.array([5.0, 6.0, 7.0, -1.0]), np.array([1.0, 2.0, 3.0, 4.0])
    ours = probability_of_improvement(x, y)[0]
    # rliable forms U/(n·m); its value is a test statistic, hence the tolerance.
    theirs = metrics.probability_of_improvement(x[:, None], y[:, None])
    assert ours == pytest.approx(theirs, abs=1e-12) == 0.75


def test_trailing_mean_by_hand():
    # 1, (1+3)/2, then windows of three: (1+3+8)/3, (3+8+1)/3.
    np.testing.assert_allclose(trailing_mean(np.array([1.0, 3.0, 8.0, 1.0]), 3), [1, 2, 4, 4])
    np.testing.assert_array_equal(trailing_mean(np.array([4.0, 2.0]), 5), [4.0, 3.0])
    np.testing.assert_array_equal(trailing_mean(np.array([4.0, 2.0]), 1), [4.0, 2.0])
    assert trailing_mean(np.array([]), 3).shape == (0,)
    with pytest.raises(ValueError, match="window 0"):
        trailing_mean(np.array([1.0]), 0)


def test_first_passage_needs_a_full_window():
    returns = np.array([300.0, 0.0, 0.0, 30.0, 60.0])
    trailing = trailing_mean(returns, 3)  # 300, 150, 100, 10, 30
    assert first_passage(trailing, 100.0, 3) == 3  # not 1: its window holds one episode
    assert first_passage(trailing, 101.0, 3) is None
    assert first_passage(trailing[:2], 0.0, 3) is None
    assert first_passage(trailing[3:], 20.0, 1) == 2


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([np.nan, np.nan], [np.nan, np.nan]),
        ([np.nan, 1.0], [0.0, 0.0]),
        ([1.0, 1.0], [0.0, np.nan]),
        ([1.0] * 200, [0.0] * 199 + [np.nan]),
        ([np.nan], [0.0]),
    ],
)
def test_a_score_that_is_no_number_neither_wins_nor_loses(x, y):
    told = probability_of_improvement(np.array(x), np.array(y))
    assert np.isnan(told[:3]).all()


@pytest.mark.parametrize("statistic", [mean, interquartile_mean])
def test_nan_stays_nan_in_an_interval(statistic):
    values = np.arange(12.0).reshape(4, 3)
    values[2, 1] = np.nan
    low, high = bootstrap_interval(values, statistic)
    assert np.isnan(low).tolist() == np.isnan(high).tolist() == [False, True, False]
    # Also where no resample happens to draw it.
    assert np.isnan(bootstrap_interval(np.r_[values[:, 1], np.zeros(96)], mean, 1)).all()


def test_nan_stays_nan_in_a_trailing_mean_and_a_passage():
    trailing = trailing_mean(np.array([1.0, np.nan, 3.0, 3.0, 3.0]), 2)
    np.testing.assert_array_equal(trailing, [1.0, np.nan, np.nan, 3.0, 3.0])
    assert np.isnan(first_passage(trailing, 3.0, 2))
    # What was passed before is known.
    assert first_passage(np.array([0.0, 5.0, np.nan]), 5.0, 1) == 2
    assert first_passage(np.array([np.nan, 5.0]), 5.0, 2) == 2  # its window was not full
    assert np.isnan(first_passage(np.array([0.0, np.nan]), 5.0, 1))
