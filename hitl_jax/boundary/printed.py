"""Lines 10 to 12 of Algorithm 1 as they are printed: a critic of state and boundary."""

import dataclasses
import functools
from typing import Any

import chex
import jax
import jax.numpy as jnp

from hitl_jax.boundary.learner import BoundaryNetworks, descend_actor, descend_critic
from hitl_jax.boundary.losses import boundary_actor_loss, boundary_critic_loss
from hitl_jax.learner import networks, replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.losses import Metrics
from hitl_jax.types import BoundaryState, BoundaryTransition


@dataclasses.dataclass(frozen=True)
class PrintedLearner(BoundaryNetworks):
    """Learns π_θ and Q_ω(s, τ); see `BoundaryLearner`."""

    num_updates = 1
    least_frames = 1

    @property
    def critic(self) -> networks.BoundaryCritic:
        """Q_ω."""
        return networks.BoundaryCritic(self.hidden_sizes)

    def noise(self, key: chex.PRNGKey) -> chex.Array:
        """Normal noise, []; the key is consumed."""
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
        """Steps of the pool D (line 10); see `replay.sample_boundary`."""
        return replay.sample_boundary(memory, layout, column, key, batch_size, gamma)

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> BoundaryState:
        """Random networks and fresh optimisers (line 2); both keys are consumed."""
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        critic = self.critic.init(critic_key, observation, jnp.zeros((1,), jnp.float32))
        return self.start(actor_key, critic)

    def improve(
        self, hyper: Any, state: BoundaryState, batch: BoundaryTransition
    ) -> tuple[BoundaryState, Metrics]:
        """One update of both networks (lines 10 to 12); see `BoundaryLearner`."""
        grads, critic_metrics = jax.grad(boundary_critic_loss, has_aux=True)(
            state.critic, self.critic.apply, batch
        )
        state, critic_norm = descend_critic(hyper, state, grads)
        grads, actor_metrics = jax.grad(boundary_actor_loss, has_aux=True)(
            state.actor,
            functools.partial(self.boundary, hyper),
            self.critic.apply,
            state.critic,
            batch.observation,
        )
        state, actor_norm = descend_actor(hyper, state, grads)
        return state, critic_metrics | critic_norm | actor_metrics | actor_norm
