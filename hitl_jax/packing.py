"""A pytree as one array of words.

Each array that a compiled program takes or gives costs the host's thread some microseconds, at
every tick. Words are bit patterns: nothing is rounded.
"""

import math

import chex
import jax
import jax.numpy as jnp

from hitl_jax.keys import wrap_key


def pack(tree: chex.ArrayTree) -> chex.Array:
    """All leaves one after the other, uint32 [P].

    Args:
        tree: leaves of 32 bits an element, bool, or typed keys of `keys.make_key`.
    """
    return jnp.concatenate([_to_words(leaf).ravel() for leaf in jax.tree.leaves(tree)])


def unpack(like: chex.ArrayTree, words: chex.Array) -> chex.ArrayTree:
    """What was packed.

    Args:
        like: a tree whose structure, shapes and types are taken over.
        words: of `pack`, uint32 [P].

    Raises:
        AssertionError: if there are more or fewer words than the tree has.
    """
    shapes = [jax.eval_shape(_to_words, leaf).shape for leaf in jax.tree.leaves(like)]
    chex.assert_shape(words, (sum(map(math.prod, shapes)),))
    leaves, place = [], 0
    for leaf, shape in zip(jax.tree.leaves(like), shapes, strict=True):
        size = math.prod(shape)
        leaves.append(_from_words(leaf, words[place : place + size].reshape(shape)))
        place += size
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def _to_words(leaf: chex.Array) -> chex.Array:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.key_data(leaf)
    if leaf.dtype == bool:
        return leaf.astype(jnp.uint32)
    return jax.lax.bitcast_convert_type(leaf, jnp.uint32)


def _from_words(like: chex.Array, words: chex.Array) -> chex.Array:
    if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
        return wrap_key(words)
    if like.dtype == bool:
        return words > 0
    return jax.lax.bitcast_convert_type(words, like.dtype)
