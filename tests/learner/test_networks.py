import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.learner import networks

_KEY = jax.random.key(0)


def test_actor_is_bounded():
    actor = networks.Actor((16, 16), 4)
    observation = 100.0 * jax.random.normal(_KEY, (8, 24))
    action = actor.apply(actor.init(_KEY, observation), observation)
    assert action.shape == (8, 4)
    assert (jnp.abs(action) <= 1).all()


@pytest.mark.parametrize("layer_norm", [False, True])
def test_each_stacked_critic_equals_its_own_network(layer_norm):
    critics = networks.Critics((16, 8), 2, layer_norm)
    observation, action = jax.random.normal(_KEY, (5, 3)), jnp.ones((5, 2))
    params = critics.init(_KEY, observation, action)
    together = critics.apply(params, observation, action)
    assert together.shape == (2, 5)
    assert not np.allclose(together[0], together[1])
    for member in range(2):
        alone = jax.tree.map(lambda leaf, m=member: leaf[m : m + 1], params)
        single = networks.Critics((16, 8), 1, layer_norm).apply(alone, observation, action)
        np.testing.assert_allclose(single[0], together[member], rtol=1e-5, atol=1e-6)


def _actor(hidden_sizes, precision):
    return networks.Actor(hidden_sizes, 2, precision)


def _critics(hidden_sizes, precision):
    return networks.Critics(hidden_sizes, 2, layer_norm=True, matmul_precision=precision)


@pytest.mark.parametrize("make", [_actor, _critics])
def test_bfloat16_is_for_products_between_hidden_layers(make):
    inputs = [jax.random.normal(_KEY, (64, 3))] * (2 if make is _critics else 1)
    for sizes, rounded in (((64,), False), ((64, 64), True)):
        exact, other = make(sizes, "float32"), make(sizes, "bfloat16")
        params = other.init(_KEY, *inputs)
        chex.assert_trees_all_equal(params, exact.init(_KEY, *inputs))
        difference = jnp.abs(other.apply(params, *inputs) - exact.apply(params, *inputs)).max()
        assert (0 < difference < 0.01) if rounded else difference == 0


def test_an_actor_acts_in_float32():
    observation = jax.random.normal(_KEY, (3,))
    exact, other = _actor((64, 64), "float32"), _actor((64, 64), "bfloat16")
    params = exact.init(_KEY, observation)
    np.testing.assert_array_equal(
        other.apply(params, observation), exact.apply(params, observation)
    )


def test_normalised_critics_do_not_feel_the_size_of_their_input():
    critics = networks.Critics((16,), 1, layer_norm=True)
    observation, action = jax.random.normal(_KEY, (5, 3)), jnp.ones((5, 2))
    params = critics.init(_KEY, observation, action)
    q = critics.apply(params, observation, action)
    np.testing.assert_allclose(critics.apply(params, 9 * observation, 9 * action), q, rtol=1e-3)


def test_stacked_initialisation_has_the_scale_of_one_layer():
    params = networks.Critics((64,), 2, layer_norm=False).init(
        _KEY, jnp.zeros((1, 90)), jnp.zeros((1, 10))
    )
    kernel = params["params"]["_StackedDense_0"]["kernel"]
    # Uniform in ±1/sqrt(100): standard deviation 0.1/sqrt(3) = 0.0577.
    np.testing.assert_allclose(kernel.std(), 0.0577, atol=0.002)
    assert jnp.abs(kernel).max() <= 0.1


@pytest.mark.parametrize("initial", [0.06, 0.7, 1.4])
def test_boundary_actor_starts_at_tau_0_and_stays_in_range(initial):
    actor = networks.BoundaryActor((8,))
    observation = jax.random.normal(_KEY, (7, 24))
    args = (jnp.array(initial), jnp.array(0.05), jnp.array(1.5))
    params = actor.init(_KEY, observation, *args)
    np.testing.assert_allclose(actor.apply(params, observation, *args), initial, rtol=1e-3)
    wild = jax.tree.map(lambda leaf: leaf + 50.0, params)
    out = actor.apply(wild, observation, *args)
    assert (out >= 0.05).all()
    assert (out <= 1.5).all()


def test_boundary_critic_depends_on_the_boundary():
    critic = networks.BoundaryCritic((8,))
    observation = jax.random.normal(_KEY, (7, 24))
    params = critic.init(_KEY, observation, jnp.zeros(7))
    low, high = (critic.apply(params, observation, jnp.full(7, tau)) for tau in (0.1, 1.0))
    assert low.shape == (7,)
    assert not np.allclose(low, high)


def test_layer_norm_and_its_gradient_are_those_of_flax():
    flax_norm = nn.LayerNorm(use_bias=False, use_scale=False)
    x = 3.0 * jax.random.normal(_KEY, (7, 16)) + 2.0
    weight = jax.random.normal(jax.random.key(1), x.shape)

    def ours(x):
        return jnp.sum(weight * networks.layer_norm(x))

    def theirs(x):
        return jnp.sum(weight * flax_norm.apply({}, x))

    np.testing.assert_allclose(networks.layer_norm(x), flax_norm.apply({}, x), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(jax.grad(ours)(x), jax.grad(theirs)(x), rtol=1e-3, atol=1e-5)


def test_layer_norm_of_a_constant_row_is_zero():
    x = jnp.full((2, 16), 3.0)
    value, pullback = jax.vjp(networks.layer_norm, x)
    np.testing.assert_allclose(value, 0.0, atol=1e-6)
    assert jnp.isfinite(pullback(jnp.ones_like(x))[0]).all()
