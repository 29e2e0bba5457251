"""A pytree as one array of words.

Each array that a compiled program takes or gives costs the host's thread some microseconds, at
every tick. Words are bit patterns: nothing is rounded. Small leaves stand before large ones, each
in the order of the tree, so that the words are a few pieces that can be read and written apart.
"""

import math
from collections.abc import Sequence

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.xla.threefry import wrap_key

_LARGE = 8192
"""Words from which on a leaf is a piece by itself: 32 kB, beside which reading it is not noticed.

The order of the words, and so what a save means, depends on it: `saves.FORMAT` goes with it."""


def pack(tree: chex.ArrayTree) -> chex.Array:
    """All leaves, uint32 [P].

    Args:
        tree: leaves of 8, 16 or 32 bits an element, bool, or typed keys of `keys.make_key`.

    Raises:
        ValueError: one line, for a leaf of another type.
    """
    return jnp.concatenate(to_pieces(tree))


def unpack(like: chex.ArrayTree, words: chex.Array) -> chex.ArrayTree:
    """What was packed.

    Args:
        like: a tree whose structure, shapes and types are taken over.
        words: of `pack`, uint32 [P].

    Raises:
        AssertionError: if there are more or fewer words than the tree has.
    """
    return from_pieces(like, _split(words, piece_sizes(like)))


def to_pieces(tree: chex.ArrayTree) -> list[chex.Array]:
    """What `pack` joins, uint32 [..] each: all small leaves together, then each large one."""
    words = [_to_words(leaf).ravel() for leaf in jax.tree.leaves(tree)]
    small = [leaf for leaf in words if leaf.size < _LARGE]
    large = [leaf for leaf in words if leaf.size >= _LARGE]
    return [jnp.concatenate(small), *large] if small else large


def piece_sizes(like: chex.ArrayTree) -> list[int]:
    """How many words each of the pieces of such a tree has."""
    return [piece.size for piece in jax.eval_shape(to_pieces, like)]


def from_pieces(like: chex.ArrayTree, pieces: Sequence[chex.Array]) -> chex.ArrayTree:
    """The tree of which `to_pieces` made the pieces; see `unpack`.

    Raises:
        AssertionError: if the pieces are not such a tree's.
    """
    chex.assert_equal([piece.size for piece in pieces], piece_sizes(like))
    leaves, structure = jax.tree.flatten(like)
    shapes = [jax.eval_shape(_to_words, leaf).shape for leaf in leaves]
    sizes = [math.prod(shape) for shape in shapes]
    small = [size for size in sizes if size < _LARGE]
    few = iter(_split(pieces[0], small) if small else ())
    large = iter(pieces[1:] if small else pieces)
    return jax.tree.unflatten(
        structure,
        [
            _from_words(leaf, next(few if size < _LARGE else large).reshape(shape))
            for leaf, shape, size in zip(leaves, shapes, sizes, strict=True)
        ],
    )


def _split(words: chex.Array, sizes: Sequence[int]) -> list[chex.Array]:
    chex.assert_shape(words, (sum(sizes),))
    parts, place = [], 0
    for size in sizes:
        parts.append(words[place : place + size])
        place += size
    return parts


def _to_words(leaf: chex.Array) -> chex.Array:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.key_data(leaf)
    if leaf.dtype == bool:
        return leaf.astype(jnp.uint32)
    return jax.lax.bitcast_convert_type(leaf, _bits_of(leaf)).astype(jnp.uint32)


def _from_words(like: chex.Array, words: chex.Array) -> chex.Array:
    if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
        return wrap_key(words)
    if like.dtype == bool:
        return words > 0
    return jax.lax.bitcast_convert_type(words.astype(_bits_of(like)), like.dtype)


def _bits_of(leaf: chex.Array) -> np.dtype:
    """The type that holds an element's bits; a word holds those of a narrower one, and zeros."""
    for bits in (jnp.uint8, jnp.uint16, jnp.uint32):
        if _num_bits(leaf.dtype) == jnp.iinfo(bits).bits:
            return jnp.dtype(bits)
    raise ValueError(f"a leaf of type {leaf.dtype}: must have 8, 16 or 32 bits, or be bool or keys")


def _num_bits(dtype: np.dtype) -> int:
    if jnp.issubdtype(dtype, jnp.floating):
        return jnp.finfo(dtype).bits
    return jnp.iinfo(dtype).bits if jnp.issubdtype(dtype, jnp.integer) else 0
