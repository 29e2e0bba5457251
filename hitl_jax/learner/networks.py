"""Flax modules: actor, stacked critics, and the boundary's actor and critic.

Task networks take a `matmul_precision` (`hitl_jax.xla.dense_product`) for the products between
hidden layers: four fifths of the default's arithmetic, nine tenths with 256 units. The first
layer and the output layer stay float32.
"""

import functools
from collections.abc import Sequence
from typing import Any

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp

from hitl_jax.xla.dense_product import product

# Uniform in ±1/sqrt(fan_in), the initialisation with which the public records of this task were
# made (PyTorch's default for a linear layer).
_kernel_init = nn.initializers.variance_scaling(1.0 / 3.0, "fan_in", "uniform")
_stacked_init = nn.initializers.variance_scaling(1.0 / 3.0, "fan_in", "uniform", batch_axis=(0,))

_LAYER_NORM_EPSILON = 1e-6


def _dot_general(
    matmul_precision: str, x: chex.Array, kernel: chex.Array, *others: Any, **named: Any
) -> chex.Array:
    """What a dense layer multiplies with: `product` a minibatch [B, I], Flax's all else."""
    if x.ndim == 2:
        # A caller may close over weights of NumPy.
        return product(x, jnp.asarray(kernel), matmul_precision)
    return jax.lax.dot_general(x, kernel, *others, **named)


def _dense(features: int, matmul_precision: str = "float32") -> nn.Dense:
    """A layer of the actor; the boundary's networks are too small for `product` to matter."""
    dot_general = functools.partial(_dot_general, matmul_precision)
    return nn.Dense(features, kernel_init=_kernel_init, dot_general=dot_general)


def _precisions(hidden_sizes: Sequence[int], matmul_precision: str) -> list[str]:
    """What each hidden layer's product is made with: the first one's inputs are what is seen."""
    return [matmul_precision if index else "float32" for index in range(len(hidden_sizes))]


class Actor(nn.Module):
    """μ(s): a deterministic policy with actions in [-1, 1].

    Attributes:
        hidden_sizes: widths of the hidden layers.
        action_size: A.
        matmul_precision: of products between hidden layers, for minibatches [B, O]; a single
            observation's are float32.
    """

    hidden_sizes: Sequence[int]
    action_size: int
    matmul_precision: str = "float32"

    @nn.compact
    def __call__(self, observation: chex.Array) -> chex.Array:
        """Maps observations [..., O] to actions [..., A]."""
        x = observation
        precisions = _precisions(self.hidden_sizes, self.matmul_precision)
        for size, precision in zip(self.hidden_sizes, precisions, strict=True):
            x = nn.relu(_dense(size, precision)(x))
        return jnp.tanh(_dense(self.action_size)(x))


class _StackedDense(nn.Module):
    """E dense layers at once: one batched product instead of E small ones."""

    num_members: int
    features: int
    matmul_precision: str = "float32"

    @nn.compact
    def __call__(self, x: chex.Array) -> chex.Array:
        """Maps [B, I] (shared by the members) or [E, B, I] to [E, B, F]."""
        shape = (self.num_members, x.shape[-1], self.features)
        kernel = self.param("kernel", _stacked_init, shape, jnp.float32)
        bias_shape = (self.num_members, 1, self.features)
        bias = self.param("bias", nn.initializers.zeros, bias_shape, jnp.float32)
        if x.ndim == 2:
            # Shared, XLA would make [F, B] of it and transpose in every product that follows.
            x = jnp.broadcast_to(x, (self.num_members, *x.shape))
        return product(x, kernel, self.matmul_precision) + bias


@jax.custom_vjp
def layer_norm(x: chex.Array) -> chex.Array:
    """Rows with mean 0 and variance 1, without gain and shift (https://arxiv.org/abs/1607.06450).

    Flax's, with a gradient written out, which goes over the rows less often than one that is
    derived: 3 to 8 % of an update of small critics.

    Args:
        x: rows [..., F].

    Returns:
        Normalised rows [..., F].
    """
    return _layer_norm_forward(x)[0]


def _layer_norm_forward(x: chex.Array) -> tuple[chex.Array, tuple[chex.Array, chex.Array]]:
    mean = jnp.mean(x, axis=-1, keepdims=True)
    variance = jnp.mean(jnp.square(x), axis=-1, keepdims=True) - jnp.square(mean)
    scale = jax.lax.rsqrt(jnp.maximum(variance, 0.0) + _LAYER_NORM_EPSILON)
    normal = (x - mean) * scale
    return normal, (normal, scale)


def _layer_norm_backward(
    residuals: tuple[chex.Array, chex.Array], gradient: chex.Array
) -> tuple[chex.Array]:
    normal, scale = residuals
    mean = jnp.mean(gradient, axis=-1, keepdims=True)
    along = jnp.mean(gradient * normal, axis=-1, keepdims=True)
    return ((gradient - mean - along * normal) * scale,)


layer_norm.defvjp(_layer_norm_forward, _layer_norm_backward)


class Critics(nn.Module):
    """Q(s, a): E critics evaluated together.

    Attributes:
        hidden_sizes: widths of the hidden layers.
        num_critics: E.
        layer_norm: whether hidden layers are normalised before their nonlinearity.
        num_quantiles: Q, quantiles of the return; None for its mean.
        matmul_precision: of products between hidden layers.
    """

    hidden_sizes: Sequence[int]
    num_critics: int
    layer_norm: bool
    num_quantiles: int | None = None
    matmul_precision: str = "float32"

    @nn.compact
    def __call__(self, observation: chex.Array, action: chex.Array) -> chex.Array:
        """Maps observations [B, O] and actions [B, A] to values [E, B] or quantiles [E, B, Q]."""
        chex.assert_rank([observation, action], 2)
        x = jnp.concatenate([observation, action], axis=-1)
        precisions = _precisions(self.hidden_sizes, self.matmul_precision)
        for size, precision in zip(self.hidden_sizes, precisions, strict=True):
            x = _StackedDense(self.num_critics, size, precision)(x)
            if self.layer_norm:
                # With the axis of critics apart, XLA sums slowly where there is one critic.
                x = layer_norm(x.reshape(-1, size)).reshape(x.shape)
            x = nn.relu(x)
        if self.num_quantiles is None:
            return _StackedDense(self.num_critics, 1)(x)[..., 0]
        return _StackedDense(self.num_critics, self.num_quantiles)(x)


def _hidden(x: chex.Array, sizes: Sequence[int]) -> chex.Array:
    """What hidden layers of the networks below make of their input; within a compact call."""
    for size in sizes:
        x = nn.relu(nn.Dense(size, kernel_init=_kernel_init)(x))
    return x


class BoundaryActor(nn.Module):
    """π_θ(s): the switching boundary of a state (Algorithm 1, line 6).

    Attributes:
        hidden_sizes: widths of the hidden layers.
    """

    hidden_sizes: Sequence[int]

    @nn.compact
    def __call__(
        self, observation: chex.Array, initial: chex.Array, low: chex.Array, high: chex.Array
    ) -> chex.Array:
        """Maps observations [..., O] to boundaries [...] in (low, high), `initial` at first.

        Args:
            observation: s, [..., O].
            initial: τ_0, [], the output before any learning.
            low: least boundary, [].
            high: greatest boundary, [].
        """
        x = _hidden(observation, self.hidden_sizes)
        x = nn.Dense(1, kernel_init=nn.initializers.zeros)(x)[..., 0]
        share = jnp.clip((initial - low) / jnp.maximum(high - low, 1e-6), 1e-3, 1.0 - 1e-3)
        return low + (high - low) * jax.nn.sigmoid(jax.scipy.special.logit(share) + x)


class BoundaryCritic(nn.Module):
    """Q_ω(s, τ): the value of a boundary in a state.

    Attributes:
        hidden_sizes: widths of the hidden layers.
    """

    hidden_sizes: Sequence[int]

    @nn.compact
    def __call__(self, observation: chex.Array, boundary: chex.Array) -> chex.Array:
        """Maps observations [..., O] and boundaries [...] to values [...]."""
        x = jnp.concatenate([observation, boundary[..., None]], axis=-1)
        x = _hidden(x, self.hidden_sizes)
        return nn.Dense(1, kernel_init=_kernel_init)(x)[..., 0]


class AlarmCritic(nn.Module):
    """Q_ω(s, ·): the values of a state without an alarm, and with one.

    Besides the state it sees |c| and whether the episode has action noise: one tells of danger, the
    other decides what help is worth.

    Attributes:
        hidden_sizes: widths of the hidden layers.
        foretells: whether it foretells the human's judgement too, with hidden layers of its own.
    """

    hidden_sizes: Sequence[int]
    foretells: bool = False

    @nn.compact
    def __call__(
        self, observation: chex.Array, size: chex.Array, explores: chex.Array
    ) -> chex.Array:
        """Values of a state.

        Args:
            observation: s, [..., O].
            size: |c|, [...].
            explores: 1 for action noise, else 0, [...].

        Returns:
            Two values, [..., 2]; with `foretells` and the logit of P(h = 0) behind them, [..., 3].
        """
        x = jnp.concatenate([observation, size[..., None], explores[..., None]], axis=-1)
        values = nn.Dense(2, kernel_init=_kernel_init)(_hidden(x, self.hidden_sizes))
        if not self.foretells:
            return values
        logit = nn.Dense(1, kernel_init=_kernel_init)(_hidden(x, self.hidden_sizes))
        return jnp.concatenate([values, logit], axis=-1)


class RiskNetwork(nn.Module):
    """The logit of the risk of a state; further numbers that it sees may stand behind the state.

    Attributes:
        hidden_sizes: widths of the hidden layers.
    """

    hidden_sizes: Sequence[int]

    @nn.compact
    def __call__(self, observation: chex.Array) -> chex.Array:
        """Maps observations [..., O] to logits [...]."""
        x = _hidden(observation, self.hidden_sizes)
        return nn.Dense(1, kernel_init=_kernel_init)(x)[..., 0]
