"""Lines 10 to 12 of Algorithm 1 with a critic that knows what a boundary does: it raises an alarm.

All that depends on τ_t depends on whether |c_t| reaches it. So Q_ω(s, τ) has two values a state,
with the alarm and without, and the probability of the alarm between them:

    Q_ω(s, τ) = P(C | τ) Q_ω(s, C) + (1 − P(C | τ)) Q_ω(s, not C),

P(C | τ) = P(|c| ≥ τ + noise) under the exploration. That is smooth in τ. It is greatest where the
alarm is raised if it is worth more than none, and line 12 moves π_θ there. With a temperature T
line 12 ascends the entropy of the alarm too, as maximum-entropy learners do (Haarnoja et al. 2018):
then π_θ comes to rest where logit P(C) is the advantage of an alarm by T, and |c| − π_θ(s) tells
how much it is worth.

Nothing but r' follows from an alarm that the human does not confirm. So its value is put together
from what the machine and the human come to, and from the probability that the human confirms it:

    Q_ω(s, C) = P(h = 0) (Q_ω(s, u = 1) + ρ − p) + (1 − P(h = 0)) (Q_ω(s, not C) − ρ).

r' judges an alarm, and is no part of what both come to: their targets hold r alone.
"""

import dataclasses
import functools
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.boundary.decisions import SPAN, sample_decisions
from hitl_jax.boundary.learner import BoundaryNetworks, descend_actor, descend_critic
from hitl_jax.learner import networks, replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.losses import Metrics, bootstrap
from hitl_jax.types import BoundaryState, BoundaryTransition, Params

(
    HEAVY_TAILS,
    OFTEN,
    TWO_CRITICS,
    TARGETS,
    HALF_ALARMS,
    TAKEOVERS,
    LINE_8,
    NOISE_TOLD,
    SEES_INDICATOR,
    JUDGEMENT,
) = MARGIN_PARTS = (
    "heavy_tails",
    "often",
    "two_critics",
    "targets",
    "half_alarms",
    "takeovers",
    "line_8",
    "noise_told",
    "sees_indicator",
    "judgement",
)
"""What makes up the learner, each of which can be left out: exploration by Cauchy's noise (else
normal), four updates in a call of the learner (else one), two critics (else one), targets (else the
critics themselves), half of each minibatch with alarms (else as they come), a takeover as one
sample (else single steps), line 8's move in the target (else none), and a critic that is told which
episodes have action noise, so that line 12 can ask for values without, that sees |c| beside the
state (else it does not), and that foretells the human's judgement (else it has one value of an
alarm, whatever the human says)."""


_RAREST = 1e-4
"""Least probability of an alarm, and of none, of which a logarithm is taken."""


def alarm_probability(
    margin: chex.Array, scale: chex.Array, heavy_tails: bool = True
) -> chex.Array:
    """P(C): that |c| reaches a boundary with noise, [...].

    Args:
        margin: |c| − τ, [...].
        scale: of the noise, [].
        heavy_tails: whether the noise is Cauchy's, else normal.
    """
    distance = margin / jnp.maximum(scale, 1e-6)
    if heavy_tails:
        return 0.5 + jnp.arctan(distance) / jnp.pi
    return jax.scipy.stats.norm.cdf(distance)


def alarm_value(
    without: chex.Array,
    confirmed: chex.Array,
    logit: chex.Array,
    alarm_reward: chex.Array,
    human_price: chex.Array,
) -> chex.Array:
    """Q_ω(s, C), [...], from what may follow an alarm; see the module.

    Args:
        without: Q_ω(s, not C), [...].
        confirmed: Q_ω(s, u = 1), without ρ and p, [...].
        logit: of P(h = 0), [...].
        alarm_reward: ρ, [].
        human_price: p, [].
    """
    danger = jax.nn.sigmoid(logit)
    true, false = confirmed + alarm_reward - human_price, without - alarm_reward
    return danger * true + (1.0 - danger) * false


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

    Attributes:
        observation_size: O.
        hidden_sizes: widths of the hidden layers of both networks.
        parts: of `MARGIN_PARTS`, those that it has.
    """

    parts: tuple[str, ...] = MARGIN_PARTS

    @property
    def num_updates(self) -> int:
        """In one call of the learner."""
        return 4 if OFTEN in self.parts else 1

    @property
    def least_frames(self) -> int:
        """The replay must hold takeovers to their end."""
        return 2 * SPAN

    @property
    def critic(self) -> networks.AlarmCritic:
        """Q_ω(s, ·)."""
        return networks.AlarmCritic(self.hidden_sizes, JUDGEMENT in self.parts)

    def noise(self, key: chex.PRNGKey) -> chex.Array:
        """The exploration of π_θ in units of `boundary_noise`, []; the key is consumed."""
        if HEAVY_TAILS in self.parts:
            return jax.random.cauchy(key, (), jnp.float32)
        return jax.random.normal(key, (), jnp.float32)

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> BoundaryState:
        """Random networks and fresh optimisers (line 2); both keys are consumed."""
        observation = jnp.zeros((1, self.observation_size), jnp.float32)
        keys = jax.random.split(critic_key, 2 if TWO_CRITICS in self.parts else 1)
        one = jnp.zeros((1,), jnp.float32)
        critic = jax.vmap(lambda key: self.critic.init(key, observation, one, one))(keys)
        return dataclasses.replace(self.start(actor_key, critic), target_critic=critic)

    def draw(
        self,
        memory: replay.Replay,
        layout: Layout,
        column: chex.Array,
        key: chex.PRNGKey,
        batch_size: int,
        gamma: chex.Array,
    ) -> BoundaryTransition:
        """Decisions of the pool D (line 10), half of them alarms as far as some are found."""
        span = SPAN if TAKEOVERS in self.parts else 1
        draw = functools.partial(sample_decisions, memory, layout, column, gamma=gamma, span=span)
        if HALF_ALARMS not in self.parts:
            return draw(key, batch_size)
        keys, half = jax.random.split(key), batch_size // 2
        any_of = draw(keys[0], batch_size - half)
        alarmed = draw(keys[1], half, alarmed=True)
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
        more = batch.indicator, batch.next_indicator, batch.counts, batch.explores
        if any(leaf is None for leaf in (*more, batch.boundary_reward)):
            raise ValueError("samples without indicators and alarms: draw them by draw_boundary")
        target = self._target(hyper, state, batch)
        grads, critic_metrics = jax.grad(self._critic_loss, has_aux=True)(
            state.critic, hyper, batch, target
        )
        state, critic_norm = descend_critic(hyper, state, grads)
        grads, actor_metrics = jax.grad(self._actor_loss, has_aux=True)(
            state.actor, hyper, state.critic, batch
        )
        state, actor_norm = descend_actor(hyper, state, grads)
        step = hyper.target_step_size if TARGETS in self.parts else 1.0
        followed = optax.incremental_update(state.critic, state.target_critic, step)
        state = dataclasses.replace(state, target_critic=followed)
        return state, critic_metrics | critic_norm | actor_metrics | actor_norm

    def _told(
        self,
        critic: Params,
        observation: chex.Array,
        indicator: chex.Array,
        explores: chex.Array | None,
    ) -> chex.Array:
        """What E critics say, [E, N, 2 or 3], with 0 for what they are not to see."""
        assert explores is not None
        size = jnp.abs(indicator) * (SEES_INDICATOR in self.parts)
        noise = explores * (NOISE_TOLD in self.parts)
        apply: Any = self.critic.apply
        told: chex.Array = jax.vmap(lambda own: apply(own, observation, size, noise))(critic)
        return told

    def alarm_values(
        self,
        hyper: Any,
        critic: Params,
        observation: chex.Array,
        indicator: chex.Array,
        explores: chex.Array | None,
    ) -> tuple[chex.Array, chex.Array]:
        """Q_ω(s, not C) and Q_ω(s, C) of each critic, [E, N] each.

        Args:
            hyper: the run's hyperparameters, scalars.
            critic: parameters of E critics, stacked.
            observation: [N, O].
            indicator: c, [N].
            explores: whether there is action noise, [N].
        """
        told = self._told(critic, observation, indicator, explores)
        without, alarmed = told[..., 0], told[..., 1]
        if JUDGEMENT in self.parts:
            alarmed = alarm_value(
                without, alarmed, told[..., 2], hyper.alarm_reward, hyper.human_price
            )
        return without, alarmed

    def _likely(self, hyper: Any, indicator: chex.Array, boundary: chex.Array) -> chex.Array:
        """P(C) of boundaries that are kept within the run's bounds, [...]."""
        size, tails = jnp.abs(indicator), HEAVY_TAILS in self.parts
        likely = alarm_probability(size - boundary, hyper.boundary_noise, tails)
        likely = jnp.where(size < hyper.boundary_low, 0.0, likely)
        return jnp.where(size >= hyper.boundary_high, 1.0, likely)

    def _target(self, hyper: Any, state: BoundaryState, batch: BoundaryTransition) -> chex.Array:
        """r_i + γ Q_ω(s_{i+1}, τ') of the target critics, τ' being π_θ(s_{i+1}) moved by line 8."""
        assert batch.next_indicator is not None
        moved = batch.next_boundary - batch.boundary
        following = self.boundary(hyper, state.actor, batch.next_observation)
        if LINE_8 in self.parts:
            following += moved
        likely = self._likely(hyper, batch.next_indicator, following)
        if JUDGEMENT in self.parts:
            # r' judges the alarm of its own step. If that of the next step counted here, none would
            # be worth as much as an alarm, just where the next step will raise one.
            hyper = hyper.replace(alarm_reward=0.0, human_price=0.0)
        without, with_alarm = self.alarm_values(
            hyper, state.target_critic, batch.next_observation, batch.next_indicator, batch.explores
        )
        value = jnp.mean(likely * with_alarm + (1.0 - likely) * without, axis=0)
        value = batch.reward + batch.discount * bootstrap(batch.discount, value)
        return jax.lax.stop_gradient(value)

    def _critic_loss(
        self, critic: Params, hyper: Any, batch: BoundaryTransition, target: chex.Array
    ) -> tuple[chex.Array, Metrics]:
        """Mean squared TD error of the value of what was done (lines 10, 11).

        With `JUDGEMENT` and the cross-entropy of the judgements of alarms.
        """
        assert batch.indicator is not None and batch.boundary_reward is not None
        told = self._told(critic, batch.observation, batch.indicator, batch.explores)
        without, alarm = told[..., 0], told[..., 1]
        # A learned indicator is another one by now; without ρ nothing tells what it was.
        now = jnp.abs(batch.indicator) >= jnp.abs(batch.boundary)
        alarmed = jnp.where(hyper.alarm_reward > 0.0, batch.boundary_reward != 0.0, now)
        if JUDGEMENT not in self.parts:
            error = jnp.square(jnp.where(alarmed, alarm, without) - target)
            loss = jnp.mean(error * _weights(batch))
            return loss, {"boundary_critic_loss": loss}
        # Nor does it tell what the human said: it is held to be yes.
        confirmed = jnp.where(hyper.alarm_reward > 0.0, batch.boundary_reward > 0.0, now)
        value = jnp.where(confirmed, alarm, without)
        loss = jnp.mean(jnp.square(value - (target - batch.boundary_reward)) * _weights(batch))
        surprise = optax.sigmoid_binary_cross_entropy(told[..., 2], confirmed)
        judgement = jnp.mean(surprise * alarmed * _weights(batch))
        return loss + judgement, {
            "boundary_critic_loss": loss,
            "boundary_judgement_loss": judgement,
        }

    def _actor_loss(
        self, actor: Params, hyper: Any, critic: Params, batch: BoundaryTransition
    ) -> tuple[chex.Array, Metrics]:
        """What line 12 descends, by its gradient: −mean [Q_ω(s_i, π_θ(s_i)) + T entropy of C]."""
        assert batch.indicator is not None
        no_noise = jnp.zeros_like(batch.reward)
        without, with_alarm = self.alarm_values(
            hyper, critic, batch.observation, batch.indicator, no_noise
        )
        advantage = jax.lax.stop_gradient(jnp.mean(with_alarm - without, axis=0))
        boundary = self.boundary(hyper, actor, batch.observation)
        likely = self._likely(hyper, batch.indicator, boundary)
        # The gradient of the alarm's entropy, −logit P(C), beside that of its value.
        logit = jax.scipy.special.logit(jnp.clip(likely, _RAREST, 1.0 - _RAREST))
        gain = jax.lax.stop_gradient(advantage - hyper.boundary_temperature * logit)
        loss = -jnp.mean(gain * likely * _weights(batch))
        return loss, {
            "boundary_actor_loss": loss,
            "boundary_alarm_advantage": jnp.mean(advantage * _weights(batch)),
        }
