"""The ground: its edges near a part, its lidar, and plain terrain by key.

Heights are [TERRAIN_LENGTH, B], one corner every `TERRAIN_STEP`; the batch is the last axis.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import parts
from hitl_jax.walker.flat import of_one
from hitl_jax.walker.kernel import as_kernel
from hitl_jax.walker.plane import Vec, dot, tangent
from hitl_jax.walker.touch import SLOTS, Edges

_HULL_EDGES = 6
"""More than the hull can meet at once."""

_ANGLES = [1.5 * ray / 10.0 for ray in range(10)]
_RAYS = [
    (math.sin(a) * parts.official.LIDAR_RANGE, -math.cos(a) * parts.official.LIDAR_RANGE)
    for a in _ANGLES
]
_WINDOW = math.ceil(_RAYS[-1][0] / parts.TERRAIN_STEP) + 3
"""Edges that a ray may meet, with one to spare on either side."""


def _corners(heights: jax.Array, index: jax.Array) -> Vec:
    """Corners of the ground by their places in it, any leading axes and [..., B]."""
    inside = jnp.clip(index, 0, parts.NUM_EDGES)
    flat = inside.reshape(-1, inside.shape[-1])
    height = jnp.take_along_axis(heights, flat, axis=0, mode="clip").reshape(index.shape)
    return Vec(jnp.asarray(parts.CORNER_X)[inside], height)


def _edges(heights: jax.Array, index: jax.Array) -> Edges:
    inside = jnp.clip(index, 0, parts.NUM_EDGES - 1)
    return Edges(index, _corners(heights, inside), _corners(heights, inside + 1))


def _first(left: jax.Array) -> jax.Array:
    return jnp.floor(left / parts.TERRAIN_STEP).astype(jnp.int32)


def edges_of_parts(heights: jax.Array, left: jax.Array) -> Edges:
    """The four edges that each part of a leg may touch, from right to left.

    Box2D solves the newest contacts first, and a walker comes from the left.

    Args:
        heights: of the ground.
        left: where each part begins, its skin included [parts, B] [m].

    Returns:
        Edges [slots, parts, B].
    """
    return _edges(heights, _first(left) + jnp.arange(SLOTS)[::-1, None, None])


def edges_of_hull(heights: jax.Array, left: jax.Array) -> Edges:
    """The edges that the hull may touch.

    Args:
        heights: of the ground.
        left: where the hull begins, its skin included [B] [m].

    Returns:
        Edges [edges, B].
    """
    return _edges(heights, _first(left) + jnp.arange(_HULL_EDGES)[:, None])


def lidar(heights: jax.Array, place: Vec) -> jax.Array:
    """How far each of the ten rays gets, as a share of its length.

    Args:
        heights: of the ground.
        place: of the hull, [B] [m].

    Returns:
        Shares [10, B], 1 where a ray meets nothing.
    """
    edges = _edges(heights, _first(place.x) - 1 + jnp.arange(_WINDOW)[:, None])
    along = edges.end - edges.start
    square = dot(along, along)
    normal = tangent(along)
    away = edges.start - place
    above = dot(normal, away)
    shares = []
    for x, y in _RAYS:
        span = math.ceil(x / parts.TERRAIN_STEP) + 3
        ray = Vec(jnp.float32(x), jnp.float32(y))
        share = above[:span] / dot(_head(normal, span), ray)
        on_edge = dot(ray * share - _head(away, span), _head(along, span))
        met = (share >= 0) & (share <= 1) & (on_edge >= 0) & (on_edge <= square[:span])
        shares.append(jnp.where(met & edges.exist[:span], share, 1.0).min(0))
    return jnp.stack(shares)


def _head(vectors: Vec, count: int) -> Vec:
    return Vec(vectors.x[:count], vectors.y[:count])


def grass(key: jax.Array) -> jax.Array:
    """Plain terrain, drawn as gymnasium draws it (from other random numbers).

    A flat start, then stretches of 5 to 9 corners, the first of which repeats the height before.

    Args:
        key: consumed.

    Returns:
        Heights [TERRAIN_LENGTH] [m].
    """
    official = parts.official
    push_key, stretch_key = jax.random.split(key)
    pushes = jax.random.uniform(
        push_key, (parts.TERRAIN_LENGTH,), minval=-1.0, maxval=1.0
    ) / np.float32(official.SCALE)
    shortest, longest = official.TERRAIN_GRASS // 2, official.TERRAIN_GRASS
    stretches = jax.random.randint(stretch_key, (parts.TERRAIN_LENGTH,), shortest, longest)

    heights: jax.Array = _profile_of_one(pushes, stretches)
    return heights


def _profile(pushes: jax.Array, stretches: jax.Array) -> jax.Array:
    """Heights of the corners; arrays are [TERRAIN_LENGTH, B]."""
    official = parts.official
    start = official.TERRAIN_HEIGHT

    def corner(carry: tuple, drawn: tuple) -> tuple:
        height, velocity, left, begins = carry
        index, push, stretch = drawn
        toward = 0.01 * jnp.sign(start - height)
        faster = 0.8 * velocity + toward + jnp.where(index > official.TERRAIN_STARTPAD, push, 0.0)
        velocity = jnp.where(begins, velocity, faster)
        height = jnp.where(begins, height, height + faster)
        begins = left == 1
        left = jnp.where(begins, stretch, left - 1)
        return (height, velocity, left, begins), height

    zero = jnp.zeros_like(pushes[0])
    left = jnp.full_like(stretches[0], official.TERRAIN_STARTPAD)
    carry = zero + jnp.float32(start), zero, left, jnp.zeros_like(zero, bool)
    drawn = jnp.arange(parts.TERRAIN_LENGTH), pushes, stretches
    heights: jax.Array = jax.lax.scan(corner, carry, drawn)[1]
    return heights


_profile_of_one = of_one(lambda *drawn: as_kernel(_profile)(*drawn))
