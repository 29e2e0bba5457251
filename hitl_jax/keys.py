"""Keys of runs: JAX's own Threefry to the bit, in fewer kernels on a CPU.

On a CPU, JAX rolls Threefry's rounds into a loop, which compiles sooner. A program that draws a few
numbers at a time, as acting does, then spends more time on the loop than on the numbers. Here the
rounds are written out, so that XLA makes one kernel of a draw.
"""

import math

import chex
import jax
import jax.numpy as jnp
from jax.extend import random as extended

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = 0x1BD11BDA
_GROUPS = 5  # of four rounds each

_Words = tuple[chex.Array, chex.Array]


def make_key(seed: int) -> chex.PRNGKey:
    """A typed key, []: draws, splits and folds as `jax.random.key(seed)` does.

    Args:
        seed: in [0, 2³²).
    """
    return jax.random.key(seed, impl=_IMPLEMENTATION)


def wrap_key(words: chex.Array) -> chex.PRNGKey:
    """The typed keys, [...], of which `jax.random.key_data` gives these words, uint32 [..., 2]."""
    return jax.random.wrap_key_data(words, impl=_IMPLEMENTATION)


def _threefry(key: chex.Array, counter: _Words) -> _Words:
    """Threefry-2x32 in 20 rounds (https://doi.org/10.1145/2063384.2063405).

    Args:
        key: uint32 [2].
        counter: two words, uint32 of one shape.
    """
    schedule = (key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(_PARITY))
    x, y = counter[0] + schedule[0], counter[1] + schedule[1]
    for group in range(_GROUPS):
        for distance in _ROTATIONS[group % 2]:
            x = x + y
            y = x ^ (y << jnp.uint32(distance) | y >> jnp.uint32(32 - distance))
        x = x + schedule[(group + 1) % 3]
        y = y + schedule[(group + 2) % 3] + jnp.uint32(group + 1)
    return x, y


def _seed(seed: chex.Array) -> chex.Array:
    return jnp.stack([jnp.uint32(0), seed.astype(jnp.uint32)])


def _counter(shape: tuple[int, ...]) -> _Words:
    """The place of each draw, as two words."""
    place = jax.lax.iota(jnp.uint32, math.prod(shape)).reshape(shape)
    return jnp.zeros_like(place), place


def _split(key: chex.Array, shape: tuple[int, ...]) -> chex.Array:
    return jnp.stack(_threefry(key, _counter(shape)), axis=-1)


def _random_bits(key: chex.Array, bit_width: int, shape: tuple[int, ...]) -> chex.Array:
    if bit_width != 32:
        raise ValueError(f"draws of {bit_width} bits: must be 32")
    x, y = _threefry(key, _counter(shape))
    return x ^ y


def _fold_in(key: chex.Array, data: chex.Array) -> chex.Array:
    word = _seed(data)
    return jnp.stack(_threefry(key, (word[0], word[1])))


_IMPLEMENTATION = extended.define_prng_impl(
    key_shape=(2,),
    seed=_seed,
    split=_split,
    random_bits=_random_bits,
    fold_in=_fold_in,
    name="threefry2x32_unrolled",
    tag="uft",
)
