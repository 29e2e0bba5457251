"""Sine and cosine that find the quarter of a turn with integers, without another rounding."""

import jax
import jax.numpy as jnp

from hitl_jax.walker.gpu.sincos import quarter_waves


def sine(angle: jax.Array) -> jax.Array:
    """The sine; see `hitl_jax.walker.gpu.sincos.sine`."""
    return _quarter_wave(angle, 0)


def cosine(angle: jax.Array) -> jax.Array:
    """The cosine; see `hitl_jax.walker.gpu.sincos.cosine`."""
    return _quarter_wave(angle, 1)


def _quarter_wave(angle: jax.Array, ahead: int) -> jax.Array:
    """The sine of an angle plus `ahead` quarters of a turn."""
    quarters, odd, even = quarter_waves(angle)
    place = quarters.astype(jnp.int32) + ahead
    wave = jnp.where(place & 1 > 0, even, odd)
    return jnp.where(place & 2 > 0, -wave, wave)
