"""The margin's learner: what an alarm is worth, and a boundary that raises it where it is."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.boundary import alarm, boundary_reward, margin
from hitl_jax.boundary.decisions import sample_decisions
from hitl_jax.boundary.margin import MarginLearner, alarm_probability
from hitl_jax.config import Hyper
from hitl_jax.learner import replay
from hitl_jax.learner.frame import CUT_OFF, Layout
from hitl_jax.types import BoundaryTransition

_LEARNER = MarginLearner(2, (32,))
_HYPER = Hyper(
    alarm_reward=1.0,
    boundary_low=0.05,
    boundary_noise=0.1,
    boundary_temperature=0.0,
    boundary_actor_learning_rate=3e-3,
    boundary_critic_learning_rate=3e-3,
    target_step_size=0.05,
)


def test_the_probability_of_an_alarm_is_that_of_its_noise():
    keys = jax.random.split(jax.random.key(0), 20_000)
    noise = 0.05 * jax.vmap(_LEARNER.noise)(keys)
    for beyond in (-0.3, -0.02, 0.0, 0.1):
        raised = alarm(jnp.full(noise.shape, 0.5), jnp.maximum(0.5 - beyond + noise, 0.0))
        told = alarm_probability(jnp.float32(beyond), jnp.float32(0.05))
        np.testing.assert_allclose(raised.mean(), told, atol=0.01)
    np.testing.assert_allclose(alarm_probability(jnp.array([-0.1, 0.1]), 0.0), [0, 1], atol=1e-4)


@jax.jit
def _learn(hyper, state, key):
    """Updates where the human agrees with alarms if the first number is positive.

    There an alarm spares the walker a loss of 5, but in the three of four samples with action noise
    it costs 4, and so much by the mean that none would be raised.
    """

    def once(state, key):
        keys = jax.random.split(key, 3)
        explores = jnp.float32(jnp.arange(64) % 4 > 0)
        seen = jax.random.uniform(keys[0], (64, 2), minval=-1.0)
        indicator = 0.4 + 0.2 * seen[:, 1]
        noise = hyper.boundary_noise * jax.vmap(_LEARNER.noise)(jax.random.split(keys[1], 64))
        boundary = jnp.clip(
            _LEARNER.boundary(hyper, state.actor, seen) + noise,
            hyper.boundary_low,
            hyper.boundary_high,
        )
        alarmed, danger = indicator >= boundary, seen[:, 0] > 0.0
        lost = jnp.where(danger, -5.0, 0.0)
        quiet = jnp.where(alarmed, jnp.where(danger, 1.0, -1.0), lost)
        noisy = jnp.where(alarmed, jnp.where(danger, -4.0, -1.0), 0.0) + lost
        batch = BoundaryTransition(
            observation=seen,
            boundary=boundary,
            reward=jnp.where(explores > 0.0, noisy, quiet),
            discount=jnp.zeros(64),
            next_observation=seen,
            next_boundary=boundary,
            indicator=indicator,
            next_indicator=indicator,
            counts=jnp.ones(64),
            boundary_reward=jnp.where(alarmed, jnp.where(danger, 1.0, -1.0), 0.0),
            explores=explores,
        )
        return _LEARNER.improve(hyper, state, batch)

    return jax.lax.scan(once, state, jax.random.split(key, 3000))


@pytest.mark.parametrize("initial", [0.1, 0.4, 0.7, 1.0, 1.4])
def test_from_any_initial_boundary_alarms_are_raised_where_they_pay(initial):
    hyper = _HYPER.replace(initial_boundary=initial)
    state = _LEARNER.init(jax.random.key(1), jax.random.key(2))
    state, metrics = _learn(hyper, state, jax.random.key(3))
    assert np.isfinite(metrics["boundary_critic_loss"]).all()
    seen = jax.random.uniform(jax.random.key(4), (4000, 2), minval=-1.0)
    seen = seen[jnp.abs(seen[:, 0]) > 0.2]  # In between nobody knows.
    raised = 0.4 + 0.2 * seen[:, 1] >= _LEARNER.boundary(hyper, state.actor, seen)
    danger = seen[:, 0] > 0.0
    assert raised[danger].mean() > 0.95
    assert raised[~danger].mean() < 0.05
    size = 0.4 + 0.2 * seen[:, 1]
    values = functools.partial(_LEARNER.alarm_values, hyper, state.critic, seen, size)
    for explores, expected in ((0.0, 1.0), (1.0, -9.0)):
        without, with_alarm = values(jnp.full(len(seen), explores))
        np.testing.assert_allclose(with_alarm[:, danger].mean(), expected, atol=0.5)
        np.testing.assert_allclose(without[:, danger].mean(), -5.0, atol=0.5)


def test_with_a_temperature_the_margin_tells_what_an_alarm_is_worth():
    hyper = _HYPER.replace(boundary_temperature=4.0, initial_boundary=0.7, boundary_low=0.0)
    state = _LEARNER.init(jax.random.key(1), jax.random.key(2))
    state, _ = _learn(hyper, state, jax.random.key(3))
    for first, advantage in ((0.5, 6.0), (-0.5, -1.0)):  # See `_learn`.
        seen = jnp.full((1, 2), first).at[:, 1].set(0.9)
        boundary = _LEARNER.boundary(hyper, state.actor, seen)
        likely = alarm_probability(0.4 + 0.2 * 0.9 - boundary, hyper.boundary_noise)
        np.testing.assert_allclose(likely, jax.nn.sigmoid(advantage / 4.0), atol=0.05)


def _batch(seen, **given):
    """Samples that end the episode, where no alarm was raised, but for what is given."""
    zero = jnp.zeros(len(seen))
    whole = {"boundary": zero, "reward": zero, "discount": zero, "next_boundary": zero}
    whole |= {"indicator": zero, "next_indicator": zero, "boundary_reward": zero, "explores": zero}
    return BoundaryTransition(
        observation=seen, next_observation=seen, counts=jnp.ones(len(seen)), **(whole | given)
    )


def test_the_reward_of_a_later_alarm_is_not_in_the_targets():
    """Else none would be worth as much as an alarm wherever the next step raises one."""
    seen = jax.random.normal(jax.random.key(0), (64, 2))
    batch = _batch(seen, discount=jnp.full(64, 0.9), next_indicator=jnp.full(64, 1.6))
    state = _LEARNER.init(jax.random.key(1), jax.random.key(2))

    def target(reward):
        hyper = _HYPER.replace(alarm_reward=reward, human_price=reward / 2)
        return _LEARNER._target(hyper, state, batch)

    unjudged = _HYPER.replace(alarm_reward=0.0)
    _, with_alarm = _LEARNER.alarm_values(
        unjudged, state.target_critic, seen, batch.next_indicator, jnp.zeros(64)
    )
    expected = 0.9 * with_alarm.mean(axis=0)  # Above the greatest boundary an alarm is sure.
    for reward in (1.0, 50.0):
        np.testing.assert_allclose(target(reward), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("reward", "price", "judged"),
    [(3.0, 0.0, 1.0), (3.0, 2.0, 1.0), (3.0, 2.0, -1.0), (0.0, 0.0, 0.0)],
)
def test_each_value_is_learned_from_what_followed(reward, price, judged):
    """A confirmed alarm teaches what the human comes to, any other step what the machine does."""
    hyper = _HYPER.replace(alarm_reward=reward, human_price=price)
    seen = jax.random.uniform(jax.random.key(0), (64, 2), minval=-1.0)
    size = jnp.full(64, 0.8)
    alarm = {"indicator": size, "boundary": jnp.full(64, 0.5)}
    told = float(boundary_reward(judged != 0.0, judged > 0.0, reward, price))
    batch = _batch(
        seen, reward=jnp.full(64, 7.0 + told), boundary_reward=jnp.full(64, told), **alarm
    )
    start = _LEARNER.init(jax.random.key(1), jax.random.key(2))
    step = jax.jit(lambda state: _LEARNER.improve(hyper, state, batch)[0])
    state = start
    for _ in range(2000):
        state = step(state)
    values = functools.partial(_LEARNER.alarm_values, hyper)
    without, with_alarm = values(state.critic, seen, size, jnp.zeros(64))
    before, _ = values(start.critic, seen, size, jnp.zeros(64))
    np.testing.assert_allclose(with_alarm, 7.0 + told, atol=0.3)
    if judged < 0.0:
        np.testing.assert_allclose(without, 7.0, atol=0.3)
    else:  # Nothing says what the machine would have come to.
        assert np.abs(without - 7.0).min() > 1.0
        assert np.abs(before - 7.0).min() > 1.0


def _memory(alarms, steps=256):
    """A run of which these steps raised an alarm."""
    layout = Layout(1, 1)
    frames = np.zeros((1, steps, layout.width), np.float32)
    frames[0, :, layout.observation] = np.arange(steps)[:, None]
    frames[0, alarms, layout.boundary_reward] = -1.0
    memory = replay.begin_run(replay.init(steps, 1, layout), 0)
    return replay.add(memory, frames), layout


@pytest.mark.parametrize(
    ("alarms", "share"), [([5], 0.03), (list(range(0, 190, 4)), 0.45), ([], 0)]
)
def test_half_of_a_minibatch_has_alarms(alarms, share):
    memory, layout = _memory(alarms)
    learner = MarginLearner(1, (8,))
    batch = learner.draw(memory, layout, 0, jax.random.key(0), 512, jnp.float32(0.9))
    assert batch.boundary.shape == (512,)
    found = np.isin(np.asarray(batch.observation)[256:, 0], alarms)
    assert found.mean() >= 2 * share
    assert (np.asarray(batch.reward)[256:][found] == -1.0).all()
    np.testing.assert_allclose(np.asarray(batch.observation)[:256].mean(), 96, atol=12)


def test_a_takeover_is_one_sample():
    memory, layout = _memory([])
    frames = np.zeros((1, 256, layout.width), np.float32)
    steps = np.arange(256)
    frames[0, :, layout.observation] = steps[:, None]
    frames[0, :, layout.reward] = 1.0
    frames[0, 20:30, layout.event] = CUT_OFF  # The human acts for ten steps,
    frames[0, 50:54, layout.event] = CUT_OFF  # and for four, in which the walker falls.
    frames[0, 53, layout.terminated] = 1.0
    frames[0, 54, layout.final] = 1.0
    frames[0, 54, layout.reward] = 0.0
    frames[0, 70, layout.event] = CUT_OFF  # Time is up.
    frames[0, 70, layout.truncated] = 1.0
    frames[0, 71, layout.final] = 1.0
    memory = replay.add(replay.begin_run(replay.init(256, 1, layout), 0), frames)
    batch = sample_decisions(memory, layout, 0, jax.random.key(0), 4096, jnp.float32(0.5))
    first = np.asarray(batch.observation)[:, 0]
    for step, reward, discount, after, counts in (
        (10, 1.0, 0.5, 11, 1),
        (20, 2.0 - 0.5**9, 0.5**10, 30, 1),
        (21, None, None, 30, 0),
        (50, 2.0 - 0.5**3, 0.0, 54, 1),
        (52, None, 0.0, 54, 0),
        (70, 1.0, 0.5, 71, 1),
    ):
        found = first == step
        assert found.any()
        assert (np.asarray(batch.counts)[found] == counts).all()
        assert (np.asarray(batch.next_observation)[found, 0] == after).all()
        if reward is not None:
            np.testing.assert_allclose(np.asarray(batch.reward)[found], reward, rtol=1e-6)
        if discount is not None:
            np.testing.assert_allclose(np.asarray(batch.discount)[found], discount, rtol=1e-6)


def test_alarms_are_sought_where_they_decide():
    """Alarms stay on while the human acts; only the first of a takeover is a decision."""
    memory, layout = _memory([])
    frames = np.zeros((1, 256, layout.width), np.float32)
    frames[0, :, layout.observation] = np.arange(256)[:, None]
    held = (np.arange(256) % 40) < 20
    frames[0, held, layout.event] = CUT_OFF
    frames[0, held, layout.boundary_reward] = 1.0
    memory = replay.add(replay.begin_run(replay.init(256, 1, layout), 0), frames)
    draw = functools.partial(sample_decisions, memory, layout, 0, jax.random.key(0), 512)
    batch = draw(jnp.float32(0.9), alarmed=True)
    decisions = (np.asarray(batch.boundary_reward) != 0.0) & (np.asarray(batch.counts) > 0.0)
    first = np.asarray(batch.observation)[decisions, 0]
    assert (first % 40 == 0).all()
    assert decisions.mean() > 0.25  # One in forty frames, of sixteen draws: 0.33.


def test_what_a_run_before_has_left_does_not_matter():
    layout = Layout(1, 1)
    memory = replay.init(128, 1, layout)
    memory = replay.add(memory, np.full((1, 128, layout.width), np.nan, np.float32))
    memory = replay.add(replay.begin_run(memory, 0), np.zeros((1, 32, layout.width), np.float32))
    batch = sample_decisions(memory, layout, 0, jax.random.key(0), 64, jnp.float32(0.9))
    assert all(not np.asarray(leaf).any() for leaf in jax.tree.leaves(batch))


@pytest.mark.slow
@pytest.mark.parametrize("left_out", margin.MARGIN_PARTS)
def test_each_part_can_be_left_out(left_out):
    parts = tuple(part for part in margin.MARGIN_PARTS if part != left_out)
    whole, learner = _LEARNER, dataclasses.replace(_LEARNER, parts=parts)
    memory, layout = _memory([5, 90])
    frames = np.zeros((1, 256, layout.width), np.float32)
    frames[0, 20:30, layout.event] = CUT_OFF
    frames[0, :, layout.next_boundary] = 0.1
    frames[0, ::2, layout.explores] = 1.0
    frames[0, [20, 90], layout.boundary_reward] = 1.0
    memory = replay.add(memory, frames)

    def after(one):
        one = dataclasses.replace(one, observation_size=1)
        batch = one.draw(memory, layout, 0, jax.random.key(0), 64, jnp.float32(0.9))
        indicator = jnp.linspace(0.0, 0.1, 64)
        batch = batch.replace(indicator=indicator, next_indicator=indicator)
        state = one.init(jax.random.key(1), jax.random.key(2))
        for _ in range(2):
            state, _metrics = one.improve(_HYPER, state, batch)
        noise = one.noise(jax.random.key(3))
        return one.num_updates, noise, batch.counts, (state.critic, state.actor)

    def equal(a, b):
        pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
        return all(np.array_equal(x, y) for x, y in pairs)

    assert not equal(after(whole), after(learner))


@pytest.mark.parametrize(
    ("size", "boundary"), [(0.02, 0.06), (0.02, 1.49), (1.6, 1.49), (0.5, 0.4)]
)
def test_bounds_are_part_of_the_probability(size, boundary):
    hyper = Hyper()
    noise = hyper.boundary_noise * jax.vmap(_LEARNER.noise)(
        jax.random.split(jax.random.key(0), 20_000)
    )
    executed = jnp.clip(boundary + noise, hyper.boundary_low, hyper.boundary_high)
    told = _LEARNER._likely(hyper, jnp.float32(size), jnp.float32(boundary))
    np.testing.assert_allclose((size >= executed).mean(), told, atol=0.01)


def test_other_samples_are_refused_in_one_line():
    state = _LEARNER.init(jax.random.key(1), jax.random.key(2))
    one = jnp.zeros((1, 2))
    sample = BoundaryTransition(one, one[0, :1], one[0, :1], one[0, :1], one, one[0, :1])
    with pytest.raises(ValueError, match=r"^samples without indicators and alarms"):
        _LEARNER.improve(_HYPER, state, sample)
