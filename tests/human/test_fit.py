"""A simulated human is found again in its own judgements."""

import jax
import numpy as np
import pytest

from hitl_jax import human
from hitl_jax.human.fit import fit_human


def _judgements(signal, begins, tolerance, delay):
    """What `hitl_jax.human` judges of hull angles [T]."""
    part = human.chain(human.threshold(), human.delayed())
    params = human.HumanParams(tolerance=tolerance, delay=delay)
    state, judged = part.init(), []
    for angle, first in zip(signal, begins, strict=True):
        state = part.begin_episode(state) if first else state
        observation = np.zeros(24, np.float32)
        observation[0] = angle
        state, dangerous = part.judge(state, params, observation, False, jax.random.key(0))
        judged.append(bool(dangerous))
    return np.array(judged)


@pytest.fixture(scope="module")
def angles():
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.normal(0, 0.05, 600))
    return np.float32(walk - 0.5), np.arange(600) % 150 == 0


@pytest.mark.parametrize(("tolerance", "delay"), [(0.4, 0), (0.6, 7), (0.2, 25)])
def test_threshold_and_delay_are_found(angles, tolerance, delay):
    signal, begins = angles
    dangerous = _judgements(signal, begins, tolerance, delay)
    fit = fit_human(np.abs(signal), begins, dangerous)
    assert fit.delay == delay
    assert fit.tolerance == pytest.approx(tolerance, abs=0.02)
    assert (fit.missed, fit.feared, fit.disagrees) == (0, 0, 0)


def test_mistakes_are_counted(angles):
    signal, begins = angles
    dangerous = _judgements(signal, begins, 0.4, 7)
    flipped = np.random.default_rng(1).random(600) < 0.05
    fit = fit_human(np.abs(signal), begins, dangerous ^ flipped)
    assert fit.delay == 7
    assert fit.tolerance == pytest.approx(0.4, abs=0.05)
    assert fit.disagrees == pytest.approx(flipped.mean(), abs=0.01)


def test_one_who_never_or_always_judges(angles):
    signal, begins = angles
    never = fit_human(np.abs(signal), begins, np.zeros(600, bool))
    assert never.tolerance > float(np.abs(signal).max())
    assert np.isnan(never.missed)
    always = fit_human(np.abs(signal), begins, np.ones(600, bool))
    assert always.tolerance <= float(np.abs(signal).min())
    assert (always.delay, always.disagrees) == (0, 0)


@pytest.mark.parametrize("shape", [(0,), (3, 2)])
def test_no_steps_are_refused(shape):
    empty = np.zeros(shape, bool)
    with pytest.raises(ValueError, match="judgements of shapes"):
        fit_human(np.zeros(shape), empty, empty)
