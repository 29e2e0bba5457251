"""A deterministic actor-critic: DDPG, TD3, and TD3 with quantile critics are instances of it."""

import dataclasses
from collections.abc import Callable
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.choices.options import Option
from hitl_jax.learner import adam, losses, networks
from hitl_jax.learner.human_data import Drawn, HumanData
from hitl_jax.types import LearnerState, Params, Transition


@dataclasses.dataclass(frozen=True)
class DeterministicActorCritic:
    """A `TaskLearner` with a deterministic actor, which follows the first critic, as TD3's.

    Attributes:
        observation_size: O.
        action_size: A.
        hidden_sizes: widths of the hidden layers.
        layer_norm: whether the critics normalise their hidden layers.
        matmul_precision: of products between hidden layers.
        num_critics: E.
        policy_delay: critic updates to one update of the actor and the target networks.
        smooths_target: whether noise is added to the target action.
        target: TD target from reward [B], discount [B] and the target critics' answer.
        critic_loss: what the critics minimise; see `losses.critic_loss`.
        num_quantiles: Q, how many quantiles of the return a critic answers with, [E, B, Q]; None
            where it answers with the mean, [E, B].
        human_data: what it makes of the human's steps.
    """

    observation_size: int
    action_size: int
    hidden_sizes: tuple[int, ...]
    layer_norm: bool
    matmul_precision: str
    num_critics: int
    policy_delay: int
    smooths_target: bool
    target: Callable[[chex.Array, chex.Array, chex.Array], Any]
    critic_loss: Callable[..., tuple[chex.Array, losses.Metrics]]
    num_quantiles: int | None = None
    human_data: HumanData = Drawn()

    @property
    def options(self) -> tuple[Option, ...]:
        """Of what it makes of the human's steps; its other numbers are fields of `Hyper`."""
        return self.human_data.options

    @property
    def noise_size(self) -> int:
        """Of the target smoothing; DDPG does not look at it."""
        return self.action_size

    @property
    def actor(self) -> networks.Actor:
        """μ."""
        return networks.Actor(
            self.hidden_sizes, self.action_size, matmul_precision=self.matmul_precision
        )

    @property
    def critic(self) -> networks.Critics:
        """Q."""
        return self._critics(self.num_critics)

    @property
    def first_critic(self) -> networks.Critics:
        """Q_1, the critic that the actor follows."""
        return self._critics(1)

    def _critics(self, num_critics: int) -> networks.Critics:
        return networks.Critics(
            self.hidden_sizes,
            num_critics,
            self.layer_norm,
            self.num_quantiles,
            matmul_precision=self.matmul_precision,
        )

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> LearnerState:
        """See `TaskLearner`."""
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        action = jnp.zeros((1, self.action_size), jnp.float32)
        actor = self.actor.init(actor_key, observation)
        critic = self.critic.init(critic_key, observation, action)
        return LearnerState(
            actor=actor,
            critic=critic,
            target_actor=actor,
            target_critic=critic,
            actor_optimizer=adam.init(actor),
            critic_optimizer=adam.init(critic),
        )

    def with_networks(self, state: LearnerState, actor: Params, critic: Params) -> LearnerState:
        """See `TaskLearner`; the targets are the networks, and the optimisers those of `state`."""
        return dataclasses.replace(
            state,
            actor=actor,
            target_actor=actor,
            critic=critic,
            target_critic=critic,
        )

    def act(
        self, hyper: Any, actor: Params, observation: chex.Array, noise: chex.Array, scale: Any
    ) -> chex.Array:
        """μ(s_t) plus `scale` times the noise."""
        del hyper
        return self.actor.apply(actor, observation) + scale * noise

    def targets(
        self, hyper: Any, state: LearnerState, batch: Transition, noise: chex.Array
    ) -> chex.ArrayTree:
        """What `target` makes of the target networks' answers; see `TaskLearner`."""
        next_action = self.actor.apply(state.target_actor, batch.next_observation)
        if self.smooths_target:
            next_action = losses.smoothed_action(
                next_action, noise, hyper.target_noise, hyper.target_noise_clip
            )
        next_q = self.critic.apply(state.target_critic, batch.next_observation, next_action)
        return self.target(batch.reward, batch.discount, next_q)

    def improve(
        self,
        hyper: Any,
        state: LearnerState,
        batch: Transition,
        target: chex.ArrayTree,
        noise: chex.Array,
        last: bool,
    ) -> tuple[LearnerState, losses.Metrics]:
        """Updates the critics, and where it is the `last`, actor and target networks."""
        del noise
        grads, metrics = jax.grad(self._critic_loss, has_aux=True)(
            state.critic, hyper, state.actor, batch, target
        )
        critic, critic_optimizer = adam.descend(
            state.critic, grads, state.critic_optimizer, hyper.critic_learning_rate
        )
        state = dataclasses.replace(state, critic=critic, critic_optimizer=critic_optimizer)
        metrics = metrics | {"critic_gradient_norm": optax.tree.norm(grads)}
        if not last:
            return state, metrics
        grads, actor_metrics = jax.grad(self._actor_loss, has_aux=True)(
            state.actor, hyper, critic, batch
        )
        actor, actor_optimizer = adam.descend(
            state.actor, grads, state.actor_optimizer, hyper.actor_learning_rate
        )
        step = hyper.target_step_size
        state = dataclasses.replace(
            state,
            actor=actor,
            actor_optimizer=actor_optimizer,
            target_actor=optax.incremental_update(actor, state.target_actor, step),
            target_critic=optax.incremental_update(critic, state.target_critic, step),
        )
        return state, metrics | actor_metrics | {"actor_gradient_norm": optax.tree.norm(grads)}

    def _critic_loss(
        self, critic: Params, hyper: Any, actor: Params, batch: Transition, target: chex.ArrayTree
    ) -> tuple[chex.Array, losses.Metrics]:
        """The TD loss, and what is made of the human's steps."""
        loss, metrics = self.critic_loss(critic, self.critic.apply, batch, target)
        if not self.human_data.changes_critic:
            return loss, metrics
        taken, machine = (
            self._values(critic, batch.observation, action)
            for action in (batch.action, self.actor.apply(actor, batch.observation))
        )
        of_human = self.human_data.critic_loss(hyper.extra, taken, machine, batch)
        return loss + of_human, metrics | {"human_critic_loss": of_human}

    def _values(self, critic: Params, observation: chex.Array, action: chex.Array) -> chex.Array:
        """Q_e(s, a), [E, B]: of quantiles the mean."""
        answer: Any = self.critic.apply(critic, observation, action)
        return answer if self.num_quantiles is None else jnp.mean(answer, axis=-1)

    def _actor_loss(
        self, actor: Params, hyper: Any, critic: Params, batch: Transition
    ) -> tuple[chex.Array, losses.Metrics]:
        """The policy gradient's loss, and what is made of the human's steps."""
        action = self.actor.apply(actor, batch.observation)
        loss, metrics = losses.action_loss(
            action, self.first_critic.apply, critic, batch.observation
        )
        if not self.human_data.changes_actor:
            return loss, metrics
        of_human = self.human_data.actor_loss(hyper.extra, action, batch)
        return loss + of_human, metrics | {"human_data_loss": of_human}
