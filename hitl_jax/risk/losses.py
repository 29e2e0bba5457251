"""Losses of the risk critic: what it foretells, and by how much its logits are corrected."""

from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.learner.losses import Metrics
from hitl_jax.types import Outcome, Params


def risk_target(outcome: Outcome, last_risk: chex.Array) -> chex.Array:
    """Whether the walker fell within the horizon; the risk where it was cut off, if it was, [B].

    A state before a human's intervention is thus neither safe nor dangerous by that: it is as
    dangerous as the state in which the human came. (That state has the whole horizon before it
    again, so that such a target is a little high.)

    Args:
        outcome: minibatch, leading axis B.
        last_risk: risk of `outcome.last_observation`, [B].
    """
    chex.assert_equal_shape([outcome.fell, outcome.cut_off, last_risk])
    return jax.lax.stop_gradient(jnp.where(outcome.cut_off > 0.0, last_risk, outcome.fell))


def risk_loss(
    network: Params,
    logits: Callable[[Params, chex.Array, chex.Array], chex.Array],
    outcome: Outcome,
    target: chex.Array,
) -> tuple[chex.Array, Metrics]:
    """Cross-entropy of the network's uncorrected risk against the target.

    Args:
        network: parameters.
        logits: maps (parameters, observations [B, O], `Outcome.explores` [B]) to logits [B].
        outcome: minibatch, leading axis B.
        target: of `risk_target`, [B].

    Returns:
        The loss [] and the metric `risk_loss`.
    """
    foretold = logits(network, outcome.observation, outcome.explores)
    loss = _mean_cross_entropy(foretold, target, outcome.counts)
    return loss, {"risk_loss": loss}


def calibration_loss(
    correction: tuple[chex.Array, chex.Array],
    logits: chex.Array,
    target: chex.Array,
    counts: chex.Array,
) -> chex.Array:
    """Cross-entropy of corrected logits (Platt scaling, 1999), [].

    Args:
        correction: logarithm of the slope, and the offset, [] each.
        logits: of the network, [B].
        target: [B].
        counts: weight of each, [B].
    """
    slope, offset = correction
    return _mean_cross_entropy(jnp.exp(slope) * logits + offset, target, counts)


def _mean_cross_entropy(logits: chex.Array, target: chex.Array, counts: chex.Array) -> chex.Array:
    chex.assert_equal_shape([logits, target, counts])
    each = optax.sigmoid_binary_cross_entropy(logits, target)
    return jnp.sum(counts * each) / jnp.maximum(jnp.sum(counts), 1.0)
