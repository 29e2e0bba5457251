import chex
import jax
import jax.numpy as jnp
import numpy as np
import official as theirs
import pytest

from hitl_jax.human import indicator

OBSERVATION = jnp.zeros(24).at[0].set(-0.3).at[1].set(0.08)


def test_the_named_indicators_in_physical_units():
    # Angle −0.3 rad; the observation holds 2 ω / 50 = 0.08, so ω = 2 rad/s; −0.3 + 0.1 · 2 = −0.1.
    expected = {"hull_angle": -0.3, "hull_angular_velocity": 2.0, "weighted": -0.1}
    assert {*expected, "fall_risk", "lander_tilt"} == set(indicator.INDICATORS)
    for name, value in expected.items():
        chosen = indicator.INDICATORS.make(name)
        np.testing.assert_allclose(chosen(OBSERVATION), value, rtol=1e-6)
        np.testing.assert_allclose(jax.jit(chosen)(OBSERVATION), value, rtol=1e-6)
        batch = jax.vmap(chosen)(jnp.stack([OBSERVATION, 2 * OBSERVATION]))
        chex.assert_shape(batch, (2,))
        np.testing.assert_allclose(batch, [value, 2 * value], rtol=1e-6)


def test_the_risk_is_its_own_indicator():
    assert float(indicator.fall_risk(OBSERVATION, jnp.float32(0.25))) == 0.25
    assert indicator.does_see_risk(indicator.INDICATORS.make("fall_risk"))
    assert not indicator.does_see_risk(indicator.hull_angle)


def test_weights():
    np.testing.assert_allclose(indicator.weighted(2.0, 0.5)(OBSERVATION), 0.4, rtol=1e-6)
    # Weights may be traced.
    swept = jax.vmap(lambda seconds: indicator.weighted(1.0, seconds)(OBSERVATION))
    np.testing.assert_allclose(swept(jnp.array([0.0, 0.1])), [-0.3, -0.1], rtol=1e-6)


def test_units_are_those_of_the_walker():
    env = theirs.make()
    assert indicator.FPS == theirs.bipedal_walker.FPS
    env.reset(seed=0)
    for _ in range(20):
        observation, *_ = env.step(np.array([1.0, -1.0, 0.5, 0.3], np.float32))
    hull = env.hull
    assert abs(hull.angularVelocity) > 0.01
    np.testing.assert_allclose(indicator.hull_angle(observation), hull.angle, rtol=1e-6)
    np.testing.assert_allclose(
        indicator.hull_angular_velocity(observation), hull.angularVelocity, rtol=1e-6
    )
    env.close()


def test_a_function_of_ones_own():
    def lowest_lidar(observation):
        return jnp.min(observation[14:])

    assert indicator.INDICATORS.make(lowest_lidar) is lowest_lidar


@pytest.mark.parametrize("name", ["hull", "", None])
def test_an_unknown_name_is_refused_in_one_line(name):
    with pytest.raises(ValueError, match=r"must be one of hull_angle, .*weighted") as caught:
        indicator.INDICATORS.make(name)
    assert "\n" not in str(caught.value)


def test_a_batch_is_refused_at_trace_time():
    with pytest.raises(AssertionError):
        indicator.hull_angle(jnp.zeros((3, 24)))
