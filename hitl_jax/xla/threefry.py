"""Keys of runs: JAX's Threefry, whatever generator the user's configuration makes the default.

`jax_threefry_partitionable`, an option that JAX keeps for the numbers of old programs, still
decides what is drawn: runs are those of its default, true.
"""

import chex
import jax
import jax.numpy as jnp

_IMPLEMENTATION = "threefry2x32"


def make_key(seed: chex.Numeric) -> chex.PRNGKey:
    """A typed key, [].

    Args:
        seed: in [0, 2³²).
    """
    return jax.random.key(jnp.asarray(seed, jnp.uint32), impl=_IMPLEMENTATION)


def wrap_key(words: chex.Array) -> chex.PRNGKey:
    """The typed keys, [...], of which `jax.random.key_data` gives these words, uint32 [..., 2]."""
    return jax.random.wrap_key_data(words, impl=_IMPLEMENTATION)
