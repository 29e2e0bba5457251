"""Packs a pytree into one array of 32-bit words, for compiled programs and snapshots of runs.

Each array that a compiled program takes or returns costs the host's thread some microseconds at
every tick, so programs take one array. Words are bit patterns: nothing is rounded. Small leaves
come before large ones, each in the tree's order: all small leaves are one piece of the array, and
each large leaf is one, so that pieces can be read and written separately.
"""

import math
from collections.abc import Sequence

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.xla.threefry import wrap_key

_LARGE = 8192
"""A leaf of at least so many words is a piece by itself: with 32 kB the cost of a piece is small.

The order of the words depends on it: a change needs a new `training.saved_run_store.FORMAT`."""


def pack(tree: chex.ArrayTree) -> chex.Array:
    """Packs all leaves into one array.

    Args:
        tree: leaves of 8, 16 or 32 bits per element, bool, or typed keys of `threefry.make_key`.

    Returns:
        The words, uint32 [P].

    Raises:
        ValueError: for a leaf of another type; one line.
    """
    return jnp.concatenate(to_pieces(tree))


def unpack(like: chex.ArrayTree, words: chex.Array) -> chex.ArrayTree:
    """Unpacks what `pack` packed.

    Args:
        like: a tree with the structure, shapes and types of the packed one.
        words: from `pack`, uint32 [P].

    Returns:
        The packed tree.

    Raises:
        AssertionError: if the number of words is not the tree's.
    """
    return from_pieces(like, _split(words, piece_sizes(like)))


def to_pieces(tree: chex.ArrayTree) -> list[chex.Array]:
    """The pieces that `pack` joins, uint32 [words] each: all small leaves, then each large leaf."""
    words = [_to_words(leaf).ravel() for leaf in jax.tree.leaves(tree)]
    small = [leaf for leaf in words if leaf.size < _LARGE]
    large = [leaf for leaf in words if leaf.size >= _LARGE]
    return [jnp.concatenate(small), *large] if small else large


def piece_sizes(like: chex.ArrayTree) -> list[int]:
    """The number of words of each piece of a tree like this."""
    return [piece.size for piece in jax.eval_shape(to_pieces, like)]


def from_pieces(like: chex.ArrayTree, pieces: Sequence[chex.Array]) -> chex.ArrayTree:
    """Unpacks the pieces of `to_pieces`; see `unpack`.

    Raises:
        AssertionError: if the sizes of the pieces are not the tree's.
    """
    chex.assert_equal([piece.size for piece in pieces], piece_sizes(like))
    leaves, structure = jax.tree.flatten(like)
    shapes = [jax.eval_shape(_to_words, leaf).shape for leaf in leaves]
    sizes = [math.prod(shape) for shape in shapes]
    small = [size for size in sizes if size < _LARGE]
    small_words = iter(_split(pieces[0], small) if small else ())
    large = iter(pieces[1:] if small else pieces)
    return jax.tree.unflatten(
        structure,
        [
            _from_words(leaf, next(small_words if size < _LARGE else large).reshape(shape))
            for leaf, shape, size in zip(leaves, shapes, sizes, strict=True)
        ],
    )


def word_places(like: chex.ArrayTree) -> list[slice]:
    """Where `pack` puts the words of each leaf of a tree like this, in the tree's order."""
    words = [jax.eval_shape(_to_words, leaf).size for leaf in jax.tree.leaves(like)]
    packed = sorted(range(len(words)), key=lambda index: words[index] >= _LARGE)
    places, begin = [slice(0)] * len(words), 0
    for index in packed:
        places[index] = slice(begin, begin + words[index])
        begin += words[index]
    return places


def unpack_on_host(
    like: chex.ArrayTree, places: Sequence[slice], words: np.ndarray
) -> chex.ArrayTree:
    """`unpack` in NumPy, which waits for no device.

    Args:
        like: as `unpack` has it.
        places: its `word_places`.
        words: from `pack`, uint32 [P].

    Returns:
        The packed tree; of keys their words.
    """
    leaves, structure = jax.tree.flatten(like)
    return jax.tree.unflatten(
        structure,
        [_from_host_words(leaf, words[own]) for leaf, own in zip(leaves, places, strict=True)],
    )


def _from_host_words(like: chex.Array, words: np.ndarray) -> np.ndarray:
    if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
        return words.copy()
    if like.dtype == bool:
        return (words > 0).reshape(like.shape)
    return words.astype(_bits_of(like)).view(like.dtype).reshape(like.shape)


def _split(words: chex.Array, sizes: Sequence[int]) -> list[chex.Array]:
    """Words cut into consecutive parts of given sizes."""
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
    """The unsigned type of an element's width; a word holds its bits, with zeros above them."""
    for bits in (jnp.uint8, jnp.uint16, jnp.uint32):
        if _num_bits(leaf.dtype) == jnp.iinfo(bits).bits:
            return jnp.dtype(bits)
    raise ValueError(f"a leaf of type {leaf.dtype}: must have 8, 16 or 32 bits, or be bool or keys")


def _num_bits(dtype: np.dtype) -> int:
    if jnp.issubdtype(dtype, jnp.floating):
        return jnp.finfo(dtype).bits
    return jnp.iinfo(dtype).bits if jnp.issubdtype(dtype, jnp.integer) else 0
