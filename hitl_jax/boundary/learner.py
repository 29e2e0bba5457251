"""What a boundary learner is: the protocol that `team` calls, and what the learners here share."""

import dataclasses
from typing import Any, Protocol

import chex
import flax.linen as nn
import jax.numpy as jnp
import optax

from hitl_jax.learner import adam, networks, replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.losses import Metrics
from hitl_jax.types import BoundaryState, BoundaryTransition, Params


class Sizes(Protocol):
    """What a boundary learner is made from: these fields of `hitl_jax.config.AgentConfig`."""

    @property
    def observation_size(self) -> int:
        """O."""

    @property
    def boundary_hidden_sizes(self) -> tuple[int, ...]:
        """Widths of the hidden layers of both networks."""

    @property
    def margin_parts(self) -> tuple[str, ...]:
        """What makes up the learner `margin`."""


class BoundaryLearner(Protocol):
    """Learns π_θ and Q_ω (lines 2 and 10 to 12): pure functions for one run; the caller vmaps them.

    An object must be hashable, and equal to another that computes the same, as a frozen dataclass
    of what it was made from is.

    Attributes:
        num_updates: in one call of the learner.
        least_frames: fewest frames of a replay that it can draw from.
    """

    def __hash__(self) -> int: ...

    @property
    def num_updates(self) -> int:
        """See above."""

    @property
    def least_frames(self) -> int:
        """See above."""

    def boundary(self, hyper: Any, actor: Params, observation: chex.Array) -> chex.Array:
        """π_θ(s) within the run's bounds, [...], for observations [..., O]."""

    def noise(self, key: chex.PRNGKey) -> chex.Array:
        """The exploration of π_θ in units of `boundary_noise`, []; the key is consumed."""

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> BoundaryState:
        """Random networks and fresh optimisers (line 2); both keys are consumed."""

    def draw(
        self,
        memory: replay.Replay,
        layout: Layout,
        column: chex.Array,
        key: chex.PRNGKey,
        batch_size: int,
        gamma: chex.Array,
    ) -> BoundaryTransition:
        """Samples of one run's pool D (line 10).

        Args:
            memory: the replay.
            layout: its columns.
            column: the run's column, [].
            key: consumed.
            batch_size: N.
            gamma: γ, [].

        Returns:
            A minibatch, leading axis N, but for its indicators, which the caller adds.
        """

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


NEEDS = ("num_updates", "least_frames", "boundary", "noise", "init", "draw", "improve")
"""What an object must have to be a boundary learner."""


@dataclasses.dataclass(frozen=True)
class BoundaryNetworks:
    """What the boundary learners here share: π_θ, and how both networks descend.

    Attributes:
        observation_size: O.
        hidden_sizes: widths of the hidden layers of both networks.
    """

    observation_size: int
    hidden_sizes: tuple[int, ...]

    @property
    def actor(self) -> nn.Module:
        """π_θ."""
        return networks.BoundaryActor(self.hidden_sizes)

    def boundary(self, hyper: Any, actor: Params, observation: chex.Array) -> chex.Array:
        """See `BoundaryLearner`."""
        return self.actor.apply(
            actor, observation, hyper.initial_boundary, hyper.boundary_low, hyper.boundary_high
        )

    def start(self, actor_key: chex.PRNGKey, critic: Params) -> BoundaryState:
        """The state at the start of a run.

        Args:
            actor_key: for θ; consumed.
            critic: ω.
        """
        scalar = jnp.zeros((1,), jnp.float32)
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        actor = self.actor.init(actor_key, observation, scalar, scalar, scalar)
        return BoundaryState(
            actor=actor,
            critic=critic,
            actor_optimizer=adam.init(actor),
            critic_optimizer=adam.init(critic),
        )


def descend_critic(
    hyper: Any, state: BoundaryState, grads: Params
) -> tuple[BoundaryState, Metrics]:
    """One Adam step of ω.

    Args:
        hyper: the run's hyperparameters, scalars.
        state: before the step.
        grads: of the critic's loss, like ω.

    Returns:
        The next state, and the gradient's norm [] as a metric.
    """
    critic, optimizer = adam.descend(
        state.critic, grads, state.critic_optimizer, hyper.boundary_critic_learning_rate
    )
    after = dataclasses.replace(state, critic=critic, critic_optimizer=optimizer)
    return after, {"boundary_critic_gradient_norm": optax.tree.norm(grads)}


def descend_actor(hyper: Any, state: BoundaryState, grads: Params) -> tuple[BoundaryState, Metrics]:
    """One Adam step of θ; see `descend_critic`."""
    actor, optimizer = adam.descend(
        state.actor, grads, state.actor_optimizer, hyper.boundary_actor_learning_rate
    )
    after = dataclasses.replace(state, actor=actor, actor_optimizer=optimizer)
    return after, {"boundary_actor_gradient_norm": optax.tree.norm(grads)}
