import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from absl.testing import absltest, parameterized
from jax.test_util import check_grads

from hitl_jax.learner import losses
from hitl_jax.types import Transition


def _linear_critic(params, observation, action):
    """Two critics that are linear in the first observation and the first action."""
    weights = params["weights"]  # [E, 2]
    return weights[:, :1] * observation[:, 0] + weights[:, 1:] * action[:, 0]


def _linear_actor(params, observation):
    return params["gain"] * observation


_BATCH = Transition(
    observation=jnp.array([[1.0], [2.0]]),
    action=jnp.array([[0.5], [-1.0]]),
    reward=jnp.array([1.0, -1.0]),
    discount=jnp.array([0.5, 0.0]),
    next_observation=jnp.array([[2.0], [3.0]]),
)


class LossesTest(chex.TestCase):
    @chex.variants(with_jit=True, without_jit=True)
    def test_target_takes_the_smaller_critic_and_masks_termination(self):
        next_q = jnp.array([[4.0, 100.0], [6.0, 50.0]])
        target = self.variant(losses.target_q)(_BATCH.reward, _BATCH.discount, next_q)
        # 1 + 0.5 * min(4, 6) = 3; the second step terminated: -1 + 0 * 50 = -1.
        np.testing.assert_allclose(target, [3.0, -1.0])

    @chex.variants(with_jit=True, without_jit=True)
    def test_target_is_the_same_under_vmap(self):
        next_q = jnp.array([[4.0, 100.0], [6.0, 50.0]])
        stack = lambda x: jnp.stack([x, 2 * x])  # noqa: E731
        batched = self.variant(jax.vmap(losses.target_q))(
            stack(_BATCH.reward), stack(_BATCH.discount), stack(next_q)
        )
        # Second row: 2 + 1 * 8 = 10; -2 + 0 = -2.
        np.testing.assert_allclose(batched, [[3.0, -1.0], [10.0, -2.0]])

    def test_target_carries_no_gradient(self):
        grad = jax.grad(lambda q: losses.target_q(_BATCH.reward, _BATCH.discount, q).sum())
        np.testing.assert_array_equal(grad(jnp.ones((2, 2))), np.zeros((2, 2)))

    @chex.variants(with_jit=True, without_jit=True)
    def test_critic_loss_by_hand(self):
        params = {"weights": jnp.array([[1.0, 2.0], [0.0, 1.0]])}
        target = jnp.array([3.0, -1.0])
        loss, metrics = self.variant(lambda p, t: losses.critic_loss(p, _linear_critic, _BATCH, t))(
            params, target
        )
        # Critic 1: q = (1 + 1, 2 - 2) = (2, 0); errors (-1, 1); mean square 1.
        # Critic 2: q = (0.5, -1); errors (-2.5, 0); mean square 3.125. Sum 4.125.
        np.testing.assert_allclose(loss, 4.125)
        np.testing.assert_allclose(metrics["q"], (2 + 0 + 0.5 - 1) / 4)

    @chex.variants(with_jit=True, without_jit=True)
    def test_target_quantiles_leave_out_the_largest_of_all_critics(self):
        quantiles = jnp.array([[[1.0, 9.0], [0.0, 0.0]], [[2.0, 3.0], [4.0, 6.0]]])
        target = self.variant(lambda r, d, q: losses.target_quantiles(r, d, q, num_dropped=2))(
            _BATCH.reward, _BATCH.discount, quantiles
        )
        # 1 + 0.5 z; 9 and 3 are left out, and count as z = 0 of no weight. The second step
        # terminated, and 6 and 4 are left out.
        np.testing.assert_allclose(target.value.T, [[1.5, 1.0, 2.0, 1.0], [-1.0] * 4])
        np.testing.assert_allclose(target.weight.T, [[0.5, 0, 0.5, 0], [0.5, 0.5, 0, 0]])

    def test_equal_target_quantiles_are_not_all_left_out(self):
        target = losses.target_quantiles(_BATCH.reward, _BATCH.discount, jnp.ones((2, 2, 2)), 2)
        np.testing.assert_allclose(target.weight, 0.25)

    def test_target_quantiles_carry_no_gradient(self):
        def total(quantiles):
            return losses.target_quantiles(_BATCH.reward, _BATCH.discount, quantiles, 1).value.sum()

        np.testing.assert_array_equal(jax.grad(total)(jnp.ones((2, 2, 3))), np.zeros((2, 2, 3)))

    @chex.variants(with_jit=True, without_jit=True)
    def test_quantile_loss_by_hand(self):
        target = losses.Atoms(jnp.array([[0.5], [3.0]]), jnp.array([[0.25], [0.75]]))
        one = jax.tree.map(lambda leaf: leaf[:1], _BATCH)
        loss, metrics = self.variant(
            lambda p: losses.quantile_loss(p, lambda q, *_: q, one, target)
        )(jnp.array([[[0.0, 2.0]]]))
        # Levels 1/4 and 3/4. Of quantile 0 the errors are 0.5 and 3, Huber 0.125 and 2.5:
        # 0.25 (0.25 · 0.125 + 0.75 · 2.5). Of quantile 2: -1.5 and 1, Huber 1 and 0.5:
        # 0.25 · 0.25 · 1 + 0.75 · 0.75 · 0.5. Their mean.
        first = 0.25 * (0.25 * 0.125 + 0.75 * 2.5)
        second = 0.25 * 0.25 * 1.0 + 0.75 * 0.75 * 0.5
        np.testing.assert_allclose(loss, (first + second) / 2)
        np.testing.assert_allclose(metrics["q"], 1.0)

    def test_quantile_loss_finds_the_quantiles(self):
        rng = np.random.default_rng(0)
        samples = jnp.asarray(rng.normal(100.0, 50.0, (200, 1)))
        target = losses.Atoms(samples, jnp.full_like(samples, 5e-3))
        one = jax.tree.map(lambda leaf: leaf[:1], _BATCH)
        slope = jax.jit(
            jax.grad(lambda p: losses.quantile_loss(p, lambda q, *_: q, one, target)[0])
        )
        quantiles = jnp.zeros((1, 1, 4))
        for _ in range(2000):
            quantiles -= 4.0 * slope(quantiles)
        wanted = np.quantile(samples, [0.125, 0.375, 0.625, 0.875])
        np.testing.assert_allclose(quantiles[0, 0], wanted, atol=1.0)

    def test_the_gradient_of_the_quantile_loss_is_that_of_its_value(self):
        rng = np.random.default_rng(0)
        target = losses.Atoms(jnp.asarray(rng.normal(0.0, 2.0, (5, 2))), jnp.full((5, 2), 0.2))
        check_grads(
            lambda p: losses.quantile_loss(p, lambda q, *_: q, _BATCH, target)[0],
            (jnp.asarray(rng.normal(0.0, 2.0, (2, 2, 3))),),
            order=1,
            modes=["rev"],
            atol=1e-2,
            rtol=1e-2,
        )

    @chex.variants(with_jit=True, without_jit=True)
    def test_actor_loss_by_hand_follows_the_first_critic(self):
        actor = {"gain": jnp.array(0.5)}
        critic = {"weights": jnp.array([[1.0, 2.0], [50.0, 50.0]])}
        loss, _ = self.variant(
            lambda p: losses.actor_loss(
                p, _linear_actor, _linear_critic, critic, _BATCH.observation
            )
        )(actor)
        # a = (0.5, 1); q1 = (1 + 1, 2 + 2); loss = -3.
        np.testing.assert_allclose(loss, -3.0)

    def test_gradients(self):
        params = {"weights": jnp.array([[1.0, 2.0], [0.3, 1.0]])}
        target = jnp.array([3.0, -1.0])
        check_grads(
            lambda p: losses.critic_loss(p, _linear_critic, _BATCH, target)[0],
            (params,),
            order=1,
            modes=["rev"],
            atol=1e-2,
            rtol=1e-2,
        )
        check_grads(
            lambda p: losses.actor_loss(
                p, _linear_actor, _linear_critic, params, _BATCH.observation
            )[0],
            ({"gain": jnp.array(0.5)},),
            order=1,
            modes=["rev"],
            atol=1e-2,
            rtol=1e-2,
        )

    @parameterized.parameters((0.0, 10.0, 0.9), (1.0, 0.3, 1.0), (-1.0, 0.3, 0.6))
    def test_smoothed_action_by_hand(self, noise, clip, expected):
        # 0.9 + 0; 0.9 + min(1, 0.3) = 1.2 -> 1; 0.9 - 0.3 = 0.6.
        action = losses.smoothed_action(
            jnp.full((1, 1), 0.9), jnp.full((1, 1), noise), jnp.array(1.0), jnp.array(clip)
        )
        np.testing.assert_allclose(action, [[expected]], rtol=1e-6)

    def test_shapes_are_checked_at_trace_time(self):
        with pytest.raises(AssertionError):
            losses.target_q(jnp.zeros(2), jnp.zeros(3), jnp.zeros((2, 2)))


if __name__ == "__main__":
    absltest.main()
