"""Lines 10 to 12 of Algorithm 1 with a critic that knows what a boundary does: it raises an alarm.

All that depends on τ_t depends on whether |c_t| reaches it. So Q_ω(s, τ) has two values a state,
with the alarm and without, and the probability of the alarm between them:

    Q_ω(s, τ) = P(C | τ) Q_ω(s, C) + (1 − P(C | τ)) Q_ω(s, not C),

P(C | τ) = P(|c| ≥ τ + noise) under the exploration. That is smooth in τ, and line 12 ascends it.
"""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.boundary.decisions import sample_decisions
from hitl_jax.boundary.learner import BoundaryNetworks
from hitl_jax.learner import adam, networks, replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.losses import Metrics, bootstrap
from hitl_jax.types import BoundaryState, BoundaryTransition, Params

_CRITICS = 2


def alarm_probability(margin: chex.Array, scale: chex.Array) -> chex.Array:
    """P(C): that |c| reaches a boundary with Cauchy noise, [...].

    Args:
        margin: |c| − τ, [...].
        scale: of the noise, [].
    """
    return 0.5 + jnp.arctan(margin / jnp.maximum(scale, 1e-6)) / jnp.pi


def _likely(hyper: Any, indicator: chex.Array, boundary: chex.Array) -> chex.Array:
    """P(C) of boundaries that are kept within the run's bounds, [...]."""
    size = jnp.abs(indicator)
    likely = alarm_probability(size - boundary, hyper.boundary_noise)
    likely = jnp.where(size < hyper.boundary_low, 0.0, likely)
    return jnp.where(size >= hyper.boundary_high, 1.0, likely)


def alarm_values(
    apply: Any, critic: Params, observation: chex.Array
) -> tuple[chex.Array, chex.Array]:
    """Q_ω(s, not C) and Q_ω(s, C) of each critic, [E, N] each, for observations [N, O]."""
    values = jax.vmap(lambda own: apply(own, observation))(critic)
    return values[..., 0], values[..., 1]


def _weights(batch: BoundaryTransition) -> chex.Array:
    """Of the samples, of mean 1 unless none counts, [N]."""
    assert batch.counts is not None
    return batch.counts / jnp.maximum(jnp.mean(batch.counts), 1.0 / batch.counts.size)


@dataclasses.dataclass(frozen=True)
class MarginLearner(BoundaryNetworks):
    """Learns π_θ and Q_ω over the margin |c| − τ; two critics, with targets.

    The exploration of π_θ is Cauchy's: most of it is small, and now and then it reaches far beyond
    the edge of the alarm, so that both values of a state are learned wherever π_θ is, and line 12
    has a gradient there.
    """

    num_updates = 4
    """In one call of the learner."""

    @property
    def critic(self) -> networks.AlarmCritic:
        """Q_ω(s, ·)."""
        return networks.AlarmCritic(self.hidden_sizes)

    def noise(self, key: chex.PRNGKey) -> chex.Array:
        """The exploration of π_θ in units of `boundary_noise`, []; the key is consumed."""
        return jax.random.cauchy(key, (), jnp.float32)

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> BoundaryState:
        """Random networks and fresh optimisers (line 2); both keys are consumed."""
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        actor = self.init_actor(actor_key)
        critic = jax.vmap(lambda key: self.critic.init(key, observation))(
            jax.random.split(critic_key, _CRITICS)
        )
        return BoundaryState(
            actor=actor,
            critic=critic,
            actor_optimizer=adam.init(actor),
            critic_optimizer=adam.init(critic),
            target_critic=critic,
        )

    def draw(
        self,
        memory: replay.Replay,
        layout: Layout,
        column: chex.Array,
        key: chex.PRNGKey,
        batch_size: int,
        gamma: chex.Array,
    ) -> BoundaryTransition:
        """Samples of the pool D (line 10), half of them with an alarm as far as some are found."""
        keys = jax.random.split(key)
        half = batch_size // 2
        any_of = sample_decisions(memory, layout, column, keys[0], batch_size - half, gamma)
        alarmed = sample_decisions(memory, layout, column, keys[1], half, gamma, alarmed=True)
        both: BoundaryTransition = jax.tree.map(
            lambda *leaves: jnp.concatenate(leaves), any_of, alarmed
        )
        return both

    def improve(
        self, hyper: Any, state: BoundaryState, batch: BoundaryTransition
    ) -> tuple[BoundaryState, Metrics]:
        """One update of both networks (lines 10 to 12); see `BoundaryLearner.improve`.

        Raises:
            ValueError: one line, for samples that are not of `Agent.draw_boundary`.
        """
        more = batch.indicator, batch.next_indicator, batch.counts, batch.alarmed
        if any(leaf is None for leaf in more):
            raise ValueError("samples without indicators and alarms: draw them by draw_boundary")
        target = self._target(hyper, state, batch)
        grads, metrics = jax.grad(self._critic_loss, has_aux=True)(
            state.critic, hyper, batch, target
        )
        critic, critic_optimizer = adam.descend(
            state.critic, grads, state.critic_optimizer, hyper.boundary_critic_learning_rate
        )
        metrics |= {"boundary_critic_gradient_norm": optax.tree.norm(grads)}
        grads, actor_metrics = jax.grad(self._actor_loss, has_aux=True)(
            state.actor, hyper, critic, batch
        )
        actor, actor_optimizer = adam.descend(
            state.actor, grads, state.actor_optimizer, hyper.boundary_actor_learning_rate
        )
        after = BoundaryState(
            actor=actor,
            critic=critic,
            actor_optimizer=actor_optimizer,
            critic_optimizer=critic_optimizer,
            target_critic=optax.incremental_update(
                critic, state.target_critic, hyper.target_step_size
            ),
        )
        metrics |= actor_metrics | {"boundary_actor_gradient_norm": optax.tree.norm(grads)}
        return after, metrics

    def _target(self, hyper: Any, state: BoundaryState, batch: BoundaryTransition) -> chex.Array:
        """r_i + γ Q_ω(s_{i+1}, τ') of the target critics, τ' being π_θ(s_{i+1}) moved by line 8."""
        assert batch.next_indicator is not None
        moved = batch.next_boundary - batch.boundary
        following = self.boundary(hyper, state.actor, batch.next_observation) + moved
        likely = _likely(hyper, batch.next_indicator, following)
        without, with_alarm = alarm_values(
            self.critic.apply, state.target_critic, batch.next_observation
        )
        value = jnp.mean(likely * with_alarm + (1.0 - likely) * without, axis=0)
        value = batch.reward + batch.discount * bootstrap(batch.discount, value)
        return jax.lax.stop_gradient(value)

    def _critic_loss(
        self, critic: Params, hyper: Any, batch: BoundaryTransition, target: chex.Array
    ) -> tuple[chex.Array, Metrics]:
        """Mean squared TD error of the value with or without alarm, as it was (lines 10, 11)."""
        assert batch.indicator is not None and batch.alarmed is not None
        without, with_alarm = alarm_values(self.critic.apply, critic, batch.observation)
        # A learned indicator is another one by now; without ρ nothing tells what it was.
        now = jnp.abs(batch.indicator) >= jnp.abs(batch.boundary)
        alarmed = jnp.where(hyper.alarm_reward > 0.0, batch.alarmed, now)
        error = jnp.square(jnp.where(alarmed, with_alarm, without) - target)
        loss = jnp.mean(error * _weights(batch))
        return loss, {"boundary_critic_loss": loss}

    def _actor_loss(
        self, actor: Params, hyper: Any, critic: Params, batch: BoundaryTransition
    ) -> tuple[chex.Array, Metrics]:
        """−mean Q_ω(s_i, π_θ(s_i)), but for what does not depend on θ (line 12)."""
        assert batch.indicator is not None
        without, with_alarm = alarm_values(self.critic.apply, critic, batch.observation)
        advantage = jax.lax.stop_gradient(jnp.mean(with_alarm - without, axis=0))
        boundary = self.boundary(hyper, actor, batch.observation)
        likely = _likely(hyper, batch.indicator, boundary)
        loss = -jnp.mean(likely * advantage * _weights(batch))
        return loss, {
            "boundary_actor_loss": loss,
            "boundary_alarm_advantage": jnp.mean(advantage * _weights(batch)),
        }
