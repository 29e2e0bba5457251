"""Adam, as all learners here use it: one step with a learning rate that can be traced."""

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.types import Params

_adam = optax.scale_by_adam()
_MEAN_DECAY, _SQUARE_DECAY, _EPSILON = 0.9, 0.999, 1e-8


def init(params: Params) -> optax.OptState:
    """The state before the first step."""
    return _adam.init(params)


def descend(
    params: Params, grads: Params, optimizer: optax.OptState, learning_rate: chex.Array
) -> tuple[Params, optax.OptState]:
    """One Adam step with a traced learning rate (https://arxiv.org/abs/1412.6980).

    Optax's, but for powers of the decays: it takes those in the widest type that JAX may use.

    Args:
        params: before the step.
        grads: of the loss, like `params`.
        optimizer: of `init`, or of the step before.
        learning_rate: [].

    Returns:
        Parameters and optimiser after the step.
    """
    count = optax.safe_increment(optimizer.count)

    def moment(decay: float, before: Params, seen: Params) -> Params:
        return jax.tree.map(lambda old, new: (1.0 - decay) * new + decay * old, before, seen)

    def corrected(decay: float, moments: Params) -> Params:
        scale = 1.0 - jnp.float32(decay) ** count
        return jax.tree.map(lambda leaf: leaf / scale, moments)

    mean = moment(_MEAN_DECAY, optimizer.mu, grads)
    square = moment(_SQUARE_DECAY, optimizer.nu, jax.tree.map(jnp.square, grads))
    direction = jax.tree.map(
        lambda m, v: m / (jnp.sqrt(v) + _EPSILON),
        corrected(_MEAN_DECAY, mean),
        corrected(_SQUARE_DECAY, square),
    )
    step = jax.tree.map(lambda leaf: -learning_rate * leaf, direction)
    return optax.apply_updates(params, step), optimizer._replace(count=count, mu=mean, nu=square)
