import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import official as theirs
import pytest

from hitl_jax.human import actions as human_actions
from hitl_jax.walker import bipedal

KEY = jax.random.key(0)
WALKER = human_actions.scripted_walker()


def _play(source, observations, state=None):
    """The source's actions for observations [T, O], and its last state."""
    step = functools.partial(_step, source)
    return jax.lax.scan(step, source.init() if state is None else state, observations)


def _step(source, state, observation):
    return source.act(state, observation, KEY)


def _episode(seed, act):
    """Observations [T, O], actions [T, A] and the return of an episode.

    The walker is made anew: after other episodes, a world of Box2D answers a seed differently.
    """
    env = theirs.make()
    observation, _ = env.reset(seed=seed)
    observations, actions, total, ended = [], [], 0.0, False
    while not ended:
        observations.append(observation)
        actions.append(np.array(act(observation), np.float64))
        observation, reward, terminated, _, _ = env.step(actions[-1])
        total += float(reward)
        ended = terminated or len(actions) == bipedal.MOST_STEPS
    env.close()
    return np.array(observations), np.array(actions), total


@theirs.needs_official
@pytest.mark.parametrize("seed", range(4))
def test_the_actions_of_gymnasiums_walker(seed):
    observations, expected, _ = _episode(seed, theirs.gait())
    _, actions = jax.jit(functools.partial(_play, WALKER))(observations)
    np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-5)


@theirs.needs_official
@pytest.mark.parametrize("seed", range(3))
def test_the_returns_of_gymnasiums_walker(seed):
    """Equal to the last bit, once the compiler may not fuse a product and a sum into one rounding.

    Fused, actions differ by 1e-7, which contacts blow up to another episode.
    """
    act = jax.jit(WALKER.act, compiler_options={"xla_backend_optimization_level": 0})
    state = WALKER.init()

    def remembering(observation):
        nonlocal state
        state, action = act(state, observation, KEY)
        return action

    _, actions, total = _episode(seed, remembering)
    _, expected, expected_total = _episode(seed, theirs.gait())
    np.testing.assert_array_equal(actions, expected)
    assert total == expected_total


@theirs.needs_official
@pytest.mark.parametrize("seed", range(3))
def test_every_change_of_phase(seed):
    """Observations drawn at random, for phases that a step runs through and walks never show."""
    rng = np.random.default_rng(seed)
    observations = rng.uniform(-1.2, 1.2, (400, 24)).astype(np.float32)
    observations[:, 2] *= 0.5
    observations[:, 8], observations[:, 13] = rng.integers(0, 2, (2, 400))
    reference = theirs.bipedal_walker.BipedalWalkerHeuristics()
    step = jax.jit(WALKER.act)
    state = WALKER.init()
    changes = set()
    for observation in observations:
        before = int(state.phase), bool(state.swapped)
        expected = reference.step_heuristic(observation)
        state, action = step(state, observation, KEY)
        np.testing.assert_allclose(action, expected, rtol=0, atol=1e-5)
        assert int(state.phase) == reference.state
        assert int(state.swapped) == reference.moving_leg
        np.testing.assert_allclose(state.support_knee, reference.supporting_knee_angle, rtol=1e-6)
        changes.add((before, (int(state.phase), bool(state.swapped))))
    # Of each leg: 1→1, 1→2, 1→3, 1→1 of the other leg, 2→2, 2→3, 2→1 of the other, 3→3, 3→1.
    assert len(changes) == 18


def test_an_episode_begins_like_the_first():
    observations = np.random.default_rng(0).uniform(-1, 1, (30, 24)).astype(np.float32)
    state, first = _play(WALKER, observations)
    assert not np.array_equal(_play(WALKER, observations, state)[1], first)
    _, second = _play(WALKER, observations, WALKER.begin_episode(state))
    np.testing.assert_array_equal(first, second)


class ActionVariants(chex.TestCase):
    @chex.variants(with_jit=True, without_jit=True)
    def test_alike_however_it_is_compiled(self):
        observations = np.random.default_rng(1).uniform(-1, 1, (12, 3, 24)).astype(np.float32)
        source = human_actions.with_noise(WALKER, 0.1)
        act = self.variant(jax.vmap(source.act))
        states = jax.vmap(lambda _: source.init())(jnp.arange(3))
        keys = jax.random.split(KEY, 12)
        actions = []
        for row, key in zip(observations, keys, strict=True):
            states, action = act(states, row, jax.random.split(key, 3))
            actions.append(action)
        alone = jax.jit(source.act)
        for walker in range(3):
            state = source.init()
            for step in range(12):
                key = jax.random.split(keys[step], 3)[walker]
                state, action = alone(state, observations[step, walker], key)
                np.testing.assert_allclose(actions[step][walker], action, rtol=0, atol=1e-6)


def test_a_policy_is_its_function():
    source = human_actions.policy(lambda params, s: jnp.tanh(s @ params), jnp.ones((24, 4)))
    observation = jnp.full(24, 0.01)
    state, action = jax.jit(source.act)(source.begin_episode(source.init()), observation, KEY)
    assert state == ()
    np.testing.assert_allclose(action, np.tanh(np.full(4, 0.24)), rtol=1e-5)


def test_noise_has_its_scale_and_is_clipped():
    still = human_actions.policy(lambda params, s: params, jnp.array([0.0, 0.2, 0.0, 1.0]))
    source = human_actions.with_noise(still, 0.1)
    draw = jax.jit(jax.vmap(lambda key: source.act(source.init(), jnp.zeros(24), key)[1]))
    noisy = np.asarray(draw(jax.random.split(KEY, 10_000)))
    assert np.abs(noisy).max() <= 1.0
    # Within 4 sigma: sigma of the mean is 0.1/√n, of the standard deviation 0.1/√(2n).
    np.testing.assert_allclose(noisy[:, :3].mean(0), [0.0, 0.2, 0.0], atol=4 * 0.1 / 100)
    np.testing.assert_allclose(noisy[:, :3].std(0), 0.1, atol=4 * 0.1 / 141)
    np.testing.assert_allclose((noisy[:, 3] == 1.0).mean(), 0.5, atol=4 * 0.5 / 100)
    # Components and keys are independent: sigma of a correlation is 1/√n.
    assert abs(np.corrcoef(noisy[:, 0], noisy[:, 1])[0, 1]) < 4 / 100
    np.testing.assert_array_equal(draw(jax.random.split(KEY, 10_000)), noisy)


def test_no_noise_changes_nothing():
    observation = np.random.default_rng(2).uniform(-1, 1, 24).astype(np.float32)
    _, noisy = human_actions.with_noise(WALKER, 0.0).act(WALKER.init(), observation, KEY)
    _, plain = WALKER.act(WALKER.init(), observation, KEY)
    np.testing.assert_array_equal(noisy, plain)


def test_the_scripted_walker_says_what_it_sees():
    observation = jnp.zeros(2)
    with pytest.raises(ValueError, match=r"shape \(2,\).*24; give `make_agent`"):
        WALKER.act(WALKER.init(), observation, jax.random.key(0))
