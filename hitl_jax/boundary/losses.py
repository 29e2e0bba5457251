"""Losses of the boundary actor-critic: lines 10 to 12 of Algorithm 1."""

from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp

from hitl_jax.learner.losses import Metrics, bootstrap
from hitl_jax.types import BoundaryTransition, Params


def boundary_critic_loss(
    critic: Params,
    apply: Callable[[Params, chex.Array, chex.Array], chex.Array],
    sample: BoundaryTransition,
) -> tuple[chex.Array, Metrics]:
    """CLoss = mean (Q_ω(s_i, τ_i) − [r_i + γ Q_ω(s_{i+1}, τ_{i+1})])² (lines 10 and 11).

    The target carries no gradient; the bootstrap is masked after a terminated step.

    Args:
        critic: ω.
        apply: maps (ω, [N, O], [N]) to values [N].
        sample: minibatch of the pool D, leading axis N.

    Returns:
        The loss [] and the metric `boundary_critic_loss`.
    """
    following = apply(critic, sample.next_observation, sample.next_boundary)
    chex.assert_equal_shape([sample.reward, sample.discount, following])
    following = bootstrap(sample.discount, following)
    target = jax.lax.stop_gradient(sample.reward + sample.discount * following)
    value = apply(critic, sample.observation, sample.boundary)
    loss = jnp.mean(jnp.square(value - target))
    return loss, {"boundary_critic_loss": loss}


def boundary_actor_loss(
    actor: Params,
    apply_actor: Callable[[Params, chex.Array], chex.Array],
    apply_critic: Callable[[Params, chex.Array, chex.Array], chex.Array],
    critic: Params,
    observation: chex.Array,
) -> tuple[chex.Array, Metrics]:
    """−mean Q_ω(s_i, π_θ(s_i)): line 12 ascends it.

    The paper prints Q_ω(s_i, τ_i); its gradient in θ needs τ_i = π_θ(s_i).

    Args:
        actor: θ.
        apply_actor: maps (θ, [N, O]) to boundaries [N].
        apply_critic: maps (ω, [N, O], [N]) to values [N].
        critic: ω.
        observation: s_i, [N, O].

    Returns:
        The loss [] and the metric `boundary_actor_loss`.
    """
    loss = -jnp.mean(apply_critic(critic, observation, apply_actor(actor, observation)))
    return loss, {"boundary_actor_loss": loss}
