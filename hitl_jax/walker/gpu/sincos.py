"""Sine and cosine in operations that our kernels support."""

import math

import jax
import jax.numpy as jnp
import numpy as np


def sine(angle: jax.Array) -> jax.Array:
    """The sine to float32's precision, for angles of some thousand radians at most."""
    return _quarter_wave(angle, 0)


def cosine(angle: jax.Array) -> jax.Array:
    """The cosine; see `sine`."""
    return _quarter_wave(angle, 1)


def _quarter_wave(angle: jax.Array, ahead: int) -> jax.Array:
    """The sine of an angle plus `ahead` quarters of a turn; an integer counts them, exactly."""
    quarters, odd, even = _quarter_waves(angle)
    place = quarters.astype(jnp.int32) + ahead
    wave = jnp.where(place & 1 > 0, even, odd)
    return jnp.where(place & 2 > 0, -wave, wave)


def _quarter_waves(angle: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The nearest whole quarters of a turn, and sine and cosine of the rest of an angle.

    The rest is at most an eighth of a turn, where short polynomials are exact enough (coefficients:
    S. Moshier's Cephes library, sinf.c). The quarters are subtracted in three pieces of few bits
    each, to round less.
    """
    quarters = jax.lax.round(
        angle * np.float32(2 / math.pi), jax.lax.RoundingMethod.TO_NEAREST_EVEN
    )
    rest = angle
    for piece in (1.5703125, 4.837512969970703e-4, 7.54978995489188e-8):
        rest = rest - quarters * np.float32(piece)
    square = rest * rest
    odd = np.float32(-1.9515295891e-4) * square + np.float32(8.3321608736e-3)
    odd = rest + rest * square * (odd * square + np.float32(-1.6666654611e-1))
    even = np.float32(2.443315711809948e-5) * square + np.float32(-1.388731625493765e-3)
    even = even * square + np.float32(4.166664568298827e-2)
    even = even * square * square - np.float32(0.5) * square + np.float32(1.0)
    return quarters, odd, even
