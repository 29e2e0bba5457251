"""Makes keys of JAX's Threefry generator, whichever generator the user's configuration chooses.

`jax.random.key` uses the generator of `jax_default_prng_impl`. Runs must draw the same numbers
under any configuration, and a saved key is two words, which another generator cannot read.
`jax_threefry_partitionable` still changes what is drawn: runs use its default, true.
"""

import chex
import jax
import jax.numpy as jnp

_IMPLEMENTATION = "threefry2x32"


def make_key(seed: chex.Numeric) -> chex.PRNGKey:
    """Makes a typed key, [].

    Args:
        seed: in [0, 2³²).
    """
    return jax.random.key(jnp.asarray(seed, jnp.uint32), impl=_IMPLEMENTATION)


def wrap_key(words: chex.Array) -> chex.PRNGKey:
    """The typed keys [...] whose `jax.random.key_data` are these words, uint32 [..., 2]."""
    return jax.random.wrap_key_data(words, impl=_IMPLEMENTATION)
