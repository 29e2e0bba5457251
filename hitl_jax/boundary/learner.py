"""The actor-critic that learns the boundary: lines 2 and 10 to 12 of Algorithm 1."""

import dataclasses
import functools
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.boundary.losses import boundary_actor_loss, boundary_critic_loss
from hitl_jax.learner import adam, networks, replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.losses import Metrics
from hitl_jax.types import BoundaryState, BoundaryTransition, Params


@dataclasses.dataclass(frozen=True)
class BoundaryNetworks:
    """What boundary learners share: π_θ.

    Attributes:
        observation_size: O.
        hidden_sizes: widths of the hidden layers of both networks.
    """

    observation_size: int
    hidden_sizes: tuple[int, ...]

    @property
    def actor(self) -> networks.BoundaryActor:
        """π_θ."""
        return networks.BoundaryActor(self.hidden_sizes)

    def boundary(self, hyper: Any, actor: Params, observation: chex.Array) -> chex.Array:
        """π_θ(s) within the run's bounds, [...], for observations [..., O]."""
        return self.actor.apply(
            actor, observation, hyper.initial_boundary, hyper.boundary_low, hyper.boundary_high
        )

    def init_actor(self, key: chex.PRNGKey) -> Params:
        """θ at the start of a run; the key is consumed."""
        scalar = jnp.zeros((1,), jnp.float32)
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        return self.actor.init(key, observation, scalar, scalar, scalar)


@dataclasses.dataclass(frozen=True)
class BoundaryLearner(BoundaryNetworks):
    """Learns π_θ and Q_ω(s, τ) as printed: pure functions for one run, which the caller vmaps."""

    num_updates = 1
    """In one call of the learner."""

    @property
    def critic(self) -> networks.BoundaryCritic:
        """Q_ω."""
        return networks.BoundaryCritic(self.hidden_sizes)

    def noise(self, key: chex.PRNGKey) -> chex.Array:
        """The exploration of π_θ in units of `boundary_noise`, []; the key is consumed."""
        return jax.random.normal(key, (), jnp.float32)

    def draw(
        self,
        memory: replay.Replay,
        layout: Layout,
        column: chex.Array,
        key: chex.PRNGKey,
        batch_size: int,
        gamma: chex.Array,
    ) -> BoundaryTransition:
        """Samples of the pool D (line 10); see `replay.sample_boundary`."""
        return replay.sample_boundary(memory, layout, column, key, batch_size, gamma)

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> BoundaryState:
        """Random networks and fresh optimisers (line 2); both keys are consumed."""
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        scalar = jnp.zeros((1,), jnp.float32)
        actor = self.init_actor(actor_key)
        critic = self.critic.init(critic_key, observation, scalar)
        return BoundaryState(
            actor=actor,
            critic=critic,
            actor_optimizer=adam.init(actor),
            critic_optimizer=adam.init(critic),
        )

    def improve(
        self, hyper: Any, state: BoundaryState, batch: BoundaryTransition
    ) -> tuple[BoundaryState, Metrics]:
        """One update of both networks (lines 10 to 12).

        Args:
            hyper: the run's hyperparameters, scalars.
            state: before the update.
            batch: minibatch of the pool D, leading axis N.

        Returns:
            The next state and metrics, each [].
        """
        grads, metrics = jax.grad(boundary_critic_loss, has_aux=True)(
            state.critic, self.critic.apply, batch
        )
        critic, critic_optimizer = adam.descend(
            state.critic, grads, state.critic_optimizer, hyper.boundary_critic_learning_rate
        )
        metrics = metrics | {"boundary_critic_gradient_norm": optax.tree.norm(grads)}
        grads, actor_metrics = jax.grad(boundary_actor_loss, has_aux=True)(
            state.actor,
            functools.partial(self.boundary, hyper),
            self.critic.apply,
            critic,
            batch.observation,
        )
        actor, actor_optimizer = adam.descend(
            state.actor, grads, state.actor_optimizer, hyper.boundary_actor_learning_rate
        )
        after = BoundaryState(
            actor=actor,
            critic=critic,
            actor_optimizer=actor_optimizer,
            critic_optimizer=critic_optimizer,
        )
        metrics = metrics | actor_metrics | {"boundary_actor_gradient_norm": optax.tree.norm(grads)}
        return after, metrics
