"""The risk critic: learns from the replay how likely the walker falls within a horizon."""

import dataclasses
from typing import Any

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from hitl_jax.learner import adam, networks, replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.losses import Metrics
from hitl_jax.risk.losses import calibration_loss, risk_loss, risk_target
from hitl_jax.risk.outcomes import sample_outcomes
from hitl_jax.types import Outcome, Params, RiskCritic, RiskState

_HELD_OUT = 8000
"""Newest frames, which correct the logits before the network learns from them: what it has learned
from it foretells too boldly. While there are fewer than four times as many, a quarter of them."""

_SLOPE_RATE, _OFFSET_RATE = 3e-3, 3e-2
"""Step sizes of the correction."""


@dataclasses.dataclass(frozen=True)
class RiskLearner:
    """Learns P(the walker falls within the horizon | s), under the policy that acts.

    Pure functions for one run, which the caller vmaps. The label of a state is what happened in the
    steps after it; `losses.risk_target` says what where a human came between. The network is
    fitted to frames of the whole replay but the newest, and its logits are then corrected by a
    slope and an offset that are fitted to the newest. It is told which episodes had action noise;
    the risk that is asked for, and corrected, is that without.

    Attributes:
        observation_size: O.
        hidden_sizes: widths of the hidden layers.
        horizon: H, steps.
        batch_size: states in a minibatch.
    """

    observation_size: int
    hidden_sizes: tuple[int, ...]
    horizon: int
    batch_size: int

    @property
    def network(self) -> nn.Module:
        """Maps observations and whether there is action noise, [..., O + 1], to logits [...]."""
        return networks.RiskNetwork(self.hidden_sizes)

    def risk(self, critic: RiskCritic, observation: chex.Array) -> chex.Array:
        """P(a fall within the horizon) without action noise, [...], for observations [..., O]."""
        return self._risk(critic, observation, jnp.zeros(observation.shape[:-1], jnp.float32))

    def _risk(
        self, critic: RiskCritic, observation: chex.Array, explores: chex.Array
    ) -> chex.Array:
        logits = self._logits(critic.network, observation, explores)
        quiet = 1.0 - explores  # The correction is fitted to states without action noise.
        return jax.nn.sigmoid(jnp.exp(critic.slope * quiet) * logits + critic.offset * quiet)

    def _logits(self, network: Params, observation: chex.Array, explores: chex.Array) -> chex.Array:
        seen = jnp.concatenate([observation, explores[..., None]], axis=-1)
        logits: chex.Array = self.network.apply(network, seen)
        return logits

    def init(self, key: chex.PRNGKey) -> RiskState:
        """A random network and a fresh optimiser; the key is consumed."""
        network = self.network.init(key, jnp.zeros((1, self.observation_size + 1), jnp.float32))
        zero = jnp.zeros((), jnp.float32)
        return RiskState(RiskCritic(network, slope=zero, offset=zero), adam.init(network))

    def draw(
        self, memory: replay.Replay, layout: Layout, column: chex.Array, key: chex.PRNGKey
    ) -> tuple[Outcome, Outcome]:
        """Minibatches to learn from, and to correct the logits with.

        Args:
            memory: the replay.
            layout: its columns.
            column: the run's column, [].
            key: consumed.
        """
        keys = jax.random.split(key)
        held_out = jnp.minimum(_HELD_OUT, replay.num_starts(memory, column, self.horizon) // 4)
        sizes = self.batch_size, self.horizon
        learned = sample_outcomes(memory, layout, column, keys[0], *sizes, newest=held_out)
        new = sample_outcomes(memory, layout, column, keys[1], *sizes, count=held_out)
        return learned, new

    def improve(
        self, hyper: Any, state: RiskState, learned: Outcome, new: Outcome
    ) -> tuple[RiskState, Metrics]:
        """One update.

        Args:
            hyper: the run's hyperparameters, scalars.
            state: before the update.
            learned: minibatch to learn from, leading axis B.
            new: minibatch to correct the logits with, likewise.

        Returns:
            The next state and metrics, each [].
        """
        before = state.critic
        target = risk_target(
            learned, self._risk(before, learned.last_observation, learned.explores)
        )
        grads, metrics = jax.grad(risk_loss, has_aux=True)(
            before.network, self._logits, learned, target
        )
        network, optimizer = adam.descend(
            before.network, grads, state.optimizer, hyper.risk_learning_rate
        )
        seen = risk_target(new, self.risk(before, new.last_observation))
        logits = self._logits(before.network, new.observation, jnp.zeros_like(new.explores))
        error, (slope, offset) = jax.value_and_grad(calibration_loss)(
            (before.slope, before.offset), logits, seen, new.counts * (1.0 - new.explores)
        )
        critic = RiskCritic(
            network,
            slope=before.slope - _SLOPE_RATE * slope,
            offset=before.offset - _OFFSET_RATE * offset,
        )
        metrics |= {
            "risk_loss_on_new": error,
            "risk_gradient_norm": optax.tree.norm(grads),
        }
        return RiskState(critic, optimizer), metrics
