"""The risk critic: its labels, what it learns from a stream of known falls, and its correction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.config import RunHyper
from hitl_jax.learner import replay
from hitl_jax.learner.frame import CUT_OFF, FALL, FINISHED, GOES_ON, Layout
from hitl_jax.risk import RiskLearner, risk_target
from hitl_jax.risk.outcomes import sample_outcomes
from hitl_jax.types import Outcome, RiskCritic

_LAYOUT = Layout(2, 1)
_HORIZON = 5


def _ring(events, capacity=None):
    """A ring of one run with one frame for each event; the observation is (number, event)."""
    frames = np.zeros((1, len(events), _LAYOUT.width), np.float32)
    frames[0, :, 0] = np.arange(len(events))
    frames[0, :, 1] = frames[0, :, _LAYOUT.event] = events
    return replay.add(replay.init(capacity or len(events), 1, _LAYOUT), frames)


def _outcomes(events, **limits):
    """What is drawn, by the number of the frame."""
    memory = _ring(events)
    drawn = sample_outcomes(
        memory, _LAYOUT, jnp.int32(0), jax.random.key(0), 512, _HORIZON, **limits
    )
    number = np.asarray(drawn.observation)[:, 0].astype(int)
    return {each: jax.tree.map(lambda leaf, i=i: leaf[i], drawn) for i, each in enumerate(number)}


@pytest.mark.parametrize("event", [FALL, FINISHED, CUT_OFF])
def test_a_state_is_labelled_by_what_comes_first_within_the_horizon(event):
    events = [GOES_ON] * 20
    events[9], events[11] = event, FALL
    drawn = _outcomes(events)
    assert sorted(drawn) == list(range(15))
    for number, outcome in drawn.items():
        sees = number <= 9 < number + _HORIZON
        then_falls = number > 9 and number <= 11 < number + _HORIZON
        assert float(outcome.fell) == float((sees and event == FALL) or then_falls)
        assert float(outcome.cut_off) == float(sees and event == CUT_OFF)
        if sees:
            assert float(outcome.last_observation[0]) == 9.0
        assert float(outcome.counts) == float(not (number == 9 and event == CUT_OFF))


def test_a_frame_without_a_step_does_not_count():
    memory = _ring([GOES_ON] * 20)
    final = _LAYOUT.final - _LAYOUT.reward
    memory = memory.replace(outcome=memory.outcome.at[0, 7, final].set(1.0))
    drawn = sample_outcomes(memory, _LAYOUT, jnp.int32(0), jax.random.key(1), 256, _HORIZON)
    number = np.asarray(drawn.observation)[:, 0]
    assert np.array_equal(np.asarray(drawn.counts) == 0.0, number == 7)
    assert (number == 7).any()


def test_the_newest_are_passed_over_or_drawn_alone():
    events = [GOES_ON] * 30
    assert sorted(_outcomes(events, newest=10)) == list(range(15))
    assert sorted(_outcomes(events, count=10)) == list(range(15, 25))


def test_the_target_is_the_fall_and_where_the_human_came_the_risk_there():
    two = jnp.zeros((3, 2))
    fell, cut_off = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    outcome = Outcome(two, fell, cut_off, two, explores=two[:, 0], counts=two[:, 0])
    assert risk_target(outcome, jnp.full(3, 0.25)).tolist() == [1.0, 0.0, 0.25]


@pytest.mark.parametrize("noisy", [0.0, 0.75])
def test_it_learns_how_likely_a_fall_is_and_says_so_of_what_it_has_not_seen(noisy):
    """All walks are of 50 steps; every second one of those with an odd number ends in a fall.

    With action noise all of these do; that is not the risk that is asked for.
    """
    walks, steps = 400, 50
    odd = np.arange(walks) % 2 == 1
    falls = np.arange(walks) % 4 == 1
    frames = np.zeros((walks, steps, _LAYOUT.width), np.float32)
    frames[:, :, 0] = 1.0 - np.arange(steps) / steps
    frames[:, :, 1] = odd[:, None]
    explores = np.random.default_rng(0).uniform(size=walks) < noisy
    falls |= explores & odd
    frames[:, :, _LAYOUT.explores] = explores[:, None]
    frames[:, -1, _LAYOUT.event] = np.where(falls, FALL, FINISHED)
    memory = replay.add(
        replay.init(walks * steps, 1, _LAYOUT), frames.reshape(1, walks * steps, -1)
    )
    learner = RiskLearner(2, (16, 16), horizon=10, batch_size=64)
    hyper = RunHyper(risk_learning_rate=3e-3)

    def one(state, key):
        drawn = learner.draw(memory, _LAYOUT, jnp.int32(0), key)
        return learner.improve(hyper, state, *drawn)

    keys = jax.random.split(jax.random.key(3), 3000)
    state, metrics = jax.jit(lambda s: jax.lax.scan(one, s, keys))(learner.init(jax.random.key(2)))
    seen = jnp.array([[0.1, 1.0], [0.1, 0.0], [0.9, 1.0]])
    risk = np.asarray(learner.risk(state.critic, seen))
    assert risk == pytest.approx([0.5, 0.0, 0.0], abs=0.1)
    assert np.isfinite([np.asarray(value) for value in metrics.values()]).all()


def test_the_correction_is_of_states_without_action_noise():
    learner = RiskLearner(2, (8,), horizon=4, batch_size=2)
    critic = learner.init(jax.random.key(0)).critic
    moved = critic.replace(slope=jnp.float32(0.5), offset=jnp.float32(-1.0))
    seen = jnp.ones((2, 2))
    for explores, equal in ((0.0, False), (1.0, True)):
        told = jnp.full(2, explores)
        before, after = (learner._risk(one, seen, told) for one in (critic, moved))
        assert bool(jnp.array_equal(before, after)) is equal


def test_the_correction_moves_all_logits_alike():
    learner = RiskLearner(2, (4,), horizon=3, batch_size=8)
    critic = learner.init(jax.random.key(0)).critic
    seen = jax.random.normal(jax.random.key(1), (5, 2))
    bolder = RiskCritic(critic.network, slope=jnp.log(2.0), offset=jnp.float32(-1.0))
    logits = jax.scipy.special.logit(learner.risk(critic, seen))
    corrected = jax.scipy.special.logit(learner.risk(bolder, seen))
    np.testing.assert_allclose(corrected, 2.0 * logits - 1.0, rtol=1e-3, atol=1e-5)
