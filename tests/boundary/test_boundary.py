import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hitl_jax import boundary
from hitl_jax.types import BoundaryTransition


@pytest.mark.parametrize(
    ("indicator", "tau", "expected"),
    [(0.5, 0.4, True), (-0.5, 0.4, True), (0.3, 0.4, False), (0.4, 0.4, True), (0.5, -0.6, False)],
)
def test_alarm_compares_absolute_values(indicator, tau, expected):
    assert bool(boundary.alarm(jnp.array(indicator), jnp.array(tau))) is expected


@pytest.mark.parametrize(
    ("alarmed", "dangerous", "expected"),
    [(True, True, 0.5 - 0.01), (True, False, 0.5 + 0.02), (False, True, 0.5), (False, False, 0.5)],
)
def test_the_rule_of_line_8(alarmed, dangerous, expected):
    after = boundary.next_boundary(0.5, jnp.array(alarmed), jnp.array(dangerous), 0.01, 0.02)
    np.testing.assert_allclose(after, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("alarmed", "dangerous", "expected"), [(1, 1, 3.0), (1, 0, -3.0), (0, 1, 0.0), (0, 0, 0.0)]
)
def test_boundary_reward(alarmed, dangerous, expected):
    raised, seen = jnp.array(alarmed, bool), jnp.array(dangerous, bool)
    assert float(boundary.boundary_reward(raised, seen, 3.0)) == expected
    priced = expected - 2.0 * (alarmed and dangerous)
    assert float(boundary.boundary_reward(raised, seen, 3.0, human_price=2.0)) == priced


@pytest.mark.parametrize(
    ("precision", "settles"),
    # Above a boundary τ the precision is (1 + τ/1.5)/2: a target below 1/2 takes τ down to 0.
    [(0.3, 0.5), (0.5, 0.5), (0.8, 0.8)],
)
@pytest.mark.parametrize("start", [0.2, 1.4])
def test_the_rule_settles_at_the_target_precision_or_the_least_there_is(precision, settles, start):
    """On a stream whose danger grows with the angle, P(h=0 | C) settles at Δ⁺/(Δ⁻+Δ⁺)."""
    delta_plus, delta_minus = 2e-3 * precision, 2e-3 * (1 - precision)
    steps = 40_000

    def step(tau, key):
        angle_key, judge_key = jax.random.split(key)
        angle = jax.random.uniform(angle_key, (), maxval=1.5)
        # The human objects the more surely the larger the angle: P(h=0) = angle / 1.5.
        dangerous = jax.random.uniform(judge_key) < angle / 1.5
        alarmed = boundary.alarm(angle, tau)
        after = boundary.next_boundary(tau, alarmed, dangerous, delta_minus, delta_plus)
        return jnp.clip(after, 0.0, 1.5), (alarmed, alarmed & dangerous)

    keys = jax.random.split(jax.random.key(0), steps)
    _, (alarms, true_alarms) = jax.jit(lambda s: jax.lax.scan(step, s, keys))(jnp.array(start))
    late = slice(steps // 2, None)
    measured = true_alarms[late].sum() / alarms[late].sum()
    np.testing.assert_allclose(measured, settles, atol=0.02)


@pytest.mark.parametrize(
    ("name", "first", "tau", "second"),
    [("network", 0.0, 0.3, 0.0), ("residual", 0.0, 0.3, -0.1), ("rule", 0.7, 0.7, 0.6)],
)
def test_sources(name, first, tau, second):
    source = boundary.SOURCES.make(name)
    carry = source.init(jnp.array(0.7))
    np.testing.assert_allclose(carry, first, rtol=1e-6)
    now = source.boundary(carry, jnp.array(0.3))
    np.testing.assert_allclose(now, tau, rtol=1e-6)
    np.testing.assert_allclose(source.advance(carry, _move(now)), second, atol=1e-6)


def _move(now, **changes):
    """A true alarm, with an intervention, at τ_t."""
    given = {"boundary": now, "following": now - 0.1, "alarmed": True, "control": True}
    given |= {"step": 0.01, "target_rate": 0.1, "low": 0.05, "high": 1.5}
    return boundary.Move(**{name: jnp.asarray(value) for name, value in (given | changes).items()})


def _settle(source, tau, moved_by, keys):
    """The share of alarms, |c| ≥ τ with c normal, over the last quarter of the steps."""
    source = boundary.SOURCES.make(source)

    def step(carry, key):
        now = jnp.clip(source.boundary(carry, jnp.zeros(())), 0.05, 3.0)
        alarmed = boundary.alarm(jax.random.normal(key), now)
        move = _move(now, step=1e-3, target_rate=0.02, high=3.0, **{moved_by: alarmed})
        return source.advance(carry, move), alarmed

    _, alarms = jax.lax.scan(step, source.init(jnp.asarray(tau)), keys)
    return float(alarms[-len(keys) // 4 :].mean())


@pytest.mark.parametrize(("source", "moved_by"), [("quantile", "alarmed"), ("pid", "control")])
@pytest.mark.parametrize("tau", [0.2, 2.5])
def test_a_target_rate_is_reached(source, moved_by, tau):
    keys = jax.random.split(jax.random.key(1), 200_000)
    share = _settle(source, tau, moved_by, keys)
    assert share == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("source", ["rule", "quantile", "pid"])
def test_a_boundary_without_steps_stays(source):
    source = boundary.SOURCES.make(source)
    carry = source.advance(source.init(jnp.array(0.7)), _move(0.7))
    now = source.boundary(carry, jnp.array(0.3))
    assert now != 0.7
    after = source.advance(carry, _move(now, step=0.0, following=now))
    assert source.boundary(after, jnp.array(0.3)) == now


def test_the_integral_does_not_wind_up():
    source = boundary.SOURCES.make("pid")
    carry = source.init(jnp.array(0.7))
    for _ in range(500):
        carry = source.advance(carry, _move(0.7, step=0.1))
    assert float(carry[1]) == pytest.approx(1.5 - 0.7)


def test_unknown_source():
    with pytest.raises(ValueError, match="network, residual, rule"):
        boundary.SOURCES.make("oracle")


def _critic(params, observation, tau):
    return params["w"] * observation[:, 0] + params["v"] * tau


_SAMPLE = BoundaryTransition(
    observation=jnp.array([[1.0], [2.0]]),
    boundary=jnp.array([0.5, 0.4]),
    reward=jnp.array([1.0, -1.0]),
    discount=jnp.array([0.5, 0.0]),
    next_observation=jnp.array([[2.0], [9.0]]),
    next_boundary=jnp.array([0.4, 9.0]),
)


def test_critic_loss_by_hand():
    params = {"w": jnp.array(1.0), "v": jnp.array(2.0)}
    loss, _ = boundary.boundary_critic_loss(params, _critic, _SAMPLE)
    # y = (1 + 1, 2 + 0.8) = (2, 2.8). Targets: 1 + 0.5 (2 + 0.8) = 2.4; terminated: -1.
    # Errors (-0.4, 3.8): (0.16 + 14.44) / 2 = 7.3.
    np.testing.assert_allclose(loss, 7.3, rtol=1e-6)
    # Semi-gradient in v: mean of 2 error τ = (-0.4 * 0.5 + 3.8 * 0.4) = 1.32.
    grad = jax.grad(lambda p: boundary.boundary_critic_loss(p, _critic, _SAMPLE)[0])(params)
    np.testing.assert_allclose(grad["v"], 1.32, rtol=1e-5)


def test_actor_loss_by_hand_and_its_gradient():
    critic = {"w": jnp.array(1.0), "v": jnp.array(2.0)}

    def actor(params, observation):
        return params["g"] * observation[:, 0]

    def loss(params):
        return boundary.boundary_actor_loss(params, actor, _critic, critic, _SAMPLE.observation)[0]

    params = {"g": jnp.array(0.5)}
    # τ = (0.5, 1); Q = (1 + 1, 2 + 2); loss -3; d/dg = -mean(2 s) = -3: ascent raises τ.
    np.testing.assert_allclose(loss(params), -3.0)
    np.testing.assert_allclose(jax.grad(loss)(params)["g"], -3.0)
    check_grads(loss, (params,), order=1, modes=["rev"], atol=1e-2, rtol=1e-2)
