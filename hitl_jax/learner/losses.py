"""Losses of the task learner: one equation per function.

The differentiated parameters come first; a loss returns `(loss, metrics)`.
"""

from collections.abc import Callable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from hitl_jax.types import Params, Transition

Metrics = dict[str, chex.Array]


class Atoms(NamedTuple):
    """A distribution of returns at finitely many points.

    Attributes:
        value: the points, [M, B].
        weight: how much each counts, [M, B]; columns sum to 1.
    """

    value: chex.Array
    weight: chex.Array


def target_q(reward: chex.Array, discount: chex.Array, next_q: chex.Array) -> chex.Array:
    """TD target y = R + discount · min_e Q_e(s', μ(s')), without a gradient.

    The paper's line 10 with the (clipped double) task critics in place of Q_ω; DDPG has E = 1
    (https://arxiv.org/abs/1509.02971), TD3 has E = 2 (https://arxiv.org/abs/1802.09477, eq. 10).

    Args:
        reward: n-step reward, [B].
        discount: γ^m · (1 − terminated), [B].
        next_q: target critics at the next observation, [E, B]; not looked at where the discount is
            0.

    Returns:
        The target, [B].
    """
    chex.assert_rank([reward, discount, next_q], [1, 1, 2])
    chex.assert_equal_shape([reward, discount, next_q[0]])
    return jax.lax.stop_gradient(reward + discount * bootstrap(discount, jnp.min(next_q, axis=0)))


def bootstrap(discount: chex.Array, value: chex.Array) -> chex.Array:
    """A value that a discount is to be multiplied with; 0 where that is 0, whatever the value is.

    Args:
        discount: [...].
        value: [...].
    """
    return jnp.where(discount == 0.0, 0.0, value)


def smoothed_action(
    action: chex.Array, noise: chex.Array, scale: chex.Array, clip: chex.Array
) -> chex.Array:
    """TD3's target action ã = clip(a + clip(scale · ε, −c, c), −1, 1), eq. 14 of its paper.

    Args:
        action: target policy's action, [B, A].
        noise: standard normal ε, [B, A].
        scale: standard deviation, [].
        clip: c, [].

    Returns:
        The smoothed action, [B, A].
    """
    chex.assert_equal_shape([action, noise])
    return jnp.clip(action + jnp.clip(scale * noise, -clip, clip), -1.0, 1.0)


def critic_loss(
    critic: Params,
    apply: Callable[[Params, chex.Array, chex.Array], chex.Array],
    transition: Transition,
    target: chex.Array,
) -> tuple[chex.Array, Metrics]:
    """Sum over critics of the mean squared TD error (line 11 of Algorithm 1).

    Args:
        critic: parameters of the stacked critics.
        apply: maps (parameters, [B, O], [B, A]) to values [E, B].
        transition: minibatch, leading axis B.
        target: y, [B].

    Returns:
        The loss [] and metrics `q` (mean value) and `critic_loss`.
    """
    q = apply(critic, transition.observation, transition.action)
    chex.assert_rank([q, target], [2, 1])
    loss = jnp.sum(jnp.mean(jnp.square(q - target), axis=1))
    return loss, {"critic_loss": loss, "q": jnp.mean(q)}


def target_quantiles(
    reward: chex.Array, discount: chex.Array, next_quantiles: chex.Array, num_dropped: int
) -> Atoms:
    """TD targets of a return distribution, the largest of the pooled quantiles left out.

    y_j = R + discount · z_j over the pooled quantiles z of all critics but those of the
    `num_dropped` largest values, of equal weight, without a gradient
    (https://arxiv.org/abs/2005.04269, eq. 7 to 9).

    Args:
        reward: n-step reward, [B].
        discount: γ^m · (1 − terminated), [B].
        next_quantiles: target critics at the next observation, [E, B, Q]; not looked at where the
            discount is 0, or where they are dropped.
        num_dropped: static, of all critics together; the paper counts those of one critic.

    Returns:
        The targets and their weights, [M, B] with M = E · Q.
    """
    chex.assert_rank([reward, discount, next_quantiles], [1, 1, 3])
    chex.assert_equal_shape([reward, discount, next_quantiles[0, :, 0]])
    pooled = jnp.moveaxis(next_quantiles, 1, -1).reshape(-1, reward.shape[0])
    kept = jnp.ones(pooled.shape, bool)
    for _ in range(num_dropped):  # A sort would take longer.
        left = kept & (pooled < jnp.max(pooled, axis=0, where=kept, initial=-jnp.inf))
        kept = jnp.where(jnp.any(left, axis=0), left, kept)  # All may be equal.
    weight = kept / jnp.sum(kept, axis=0, dtype=jnp.float32)
    value = reward + discount * jnp.where(kept, bootstrap(discount, pooled), 0.0)
    return Atoms(*jax.lax.stop_gradient((value, weight)))


def quantile_loss(
    critic: Params,
    apply: Callable[[Params, chex.Array, chex.Array], chex.Array],
    transition: Transition,
    target: Atoms,
) -> tuple[chex.Array, Metrics]:
    """Quantile Huber loss, summed over critics (https://arxiv.org/abs/2005.04269, eq. 10 to 12).

    Args:
        critic: parameters of the stacked critics.
        apply: maps (parameters, [B, O], [B, A]) to quantiles [E, B, Q].
        transition: minibatch, leading axis B.
        target: y, as `Atoms` of [M, B].

    Returns:
        The loss [] and metrics `q` (mean value) and `critic_loss`.
    """
    quantiles = apply(critic, transition.observation, transition.action)
    chex.assert_rank([quantiles, target.value], [3, 2])
    count = quantiles.shape[-1]
    level = (jnp.arange(count, dtype=jnp.float32) + 0.5) / count
    each = jnp.zeros_like(quantiles)
    for place in range(len(target.value)):
        # Term by term: to sum over an axis, XLA would first write all of [E, M, B, Q].
        error = target.value[place, :, None] - quantiles
        # Huber's loss of e is c (e - c / 2), c being e clipped to [-1, 1]. Its gradient is c with
        # or without a gradient through c; without, XLA computes less.
        clipped = jax.lax.stop_gradient(jnp.clip(error, -1.0, 1.0))
        tilt = jnp.abs(level - (error < 0.0))
        each += target.weight[place, :, None] * tilt * clipped * (error - 0.5 * clipped)
    loss = jnp.sum(jnp.mean(each, axis=(1, 2)))
    return loss, {"critic_loss": loss, "q": jnp.mean(quantiles)}


def actor_loss(
    actor: Params,
    apply_actor: Callable[[Params, chex.Array], chex.Array],
    apply_critic: Callable[[Params, chex.Array, chex.Array], chex.Array],
    critic: Params,
    observation: chex.Array,
) -> tuple[chex.Array, Metrics]:
    """Deterministic policy gradient: −mean Q_1(s, μ(s)) (line 12, with a in place of τ).

    Args:
        actor: parameters of μ.
        apply_actor: maps (parameters, [B, O]) to actions [B, A].
        apply_critic: see `action_loss`.
        critic: likewise.
        observation: [B, O].

    Returns:
        The loss [] and the metric `actor_loss`.
    """
    return action_loss(apply_actor(actor, observation), apply_critic, critic, observation)


def action_loss(
    action: chex.Array,
    apply_critic: Callable[[Params, chex.Array, chex.Array], chex.Array],
    critic: Params,
    observation: chex.Array,
) -> tuple[chex.Array, Metrics]:
    """−mean Q_1(s, a) of actions that are differentiated.

    Args:
        action: a, [B, A].
        apply_critic: maps (parameters of one critic, [B, O], [B, A]) to values [1, B], or
            quantiles [1, B, Q], whose mean is the value.
        critic: parameters of the stacked critics; only the first critic is followed, as in TD3.
        observation: [B, O].

    Returns:
        The loss [] and the metric `actor_loss`.
    """
    first = jax.tree.map(lambda leaf: leaf[:1], critic)
    q = apply_critic(first, observation, action)
    loss = -jnp.mean(q)
    return loss, {"actor_loss": loss}
