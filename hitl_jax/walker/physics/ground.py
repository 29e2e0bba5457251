"""The ground near a part, and what lidar sees of it.

Terrain is [TERRAIN_LENGTH, B], one corner every `TERRAIN_STEP`; the batch is the last axis.
"""

import math

import jax
import jax.numpy as jnp

from hitl_jax.walker import bipedal, constants
from hitl_jax.walker.geometry import Vec, dot, tangent, where
from hitl_jax.walker.physics.boxes import Boxes, Near
from hitl_jax.walker.physics.manifolds import SLOTS, Edges
from hitl_jax.walker.terrain import Terrain

_HULL_EDGES = 6
"""More than the hull can meet at once."""

_WINDOW = math.ceil(bipedal.LIDAR_REACH[-1][0] / constants.TERRAIN_STEP) + 3
"""Edges that a ray may meet, with one to spare on either side."""


def _corners(heights: jax.Array, index: jax.Array) -> Vec:
    """Corners of the ground by their places in it, any leading axes and [..., B]."""
    inside = jnp.clip(index, 0, constants.NUM_EDGES)
    return Vec(jnp.asarray(constants.CORNER_X)[inside], _taken(heights, inside))


def _taken(leaf: jax.Array, index: jax.Array) -> jax.Array:
    """Of each walker's row of the terrain, what stands at some places, [..., B]."""
    flat = jnp.clip(index, 0, constants.NUM_EDGES).reshape(-1, index.shape[-1])
    return jnp.take_along_axis(leaf, flat, axis=0, mode="clip").reshape(index.shape)


def _edges(heights: jax.Array, index: jax.Array) -> Edges:
    inside = jnp.clip(index, 0, constants.NUM_EDGES - 1)
    return Edges(index, _corners(heights, inside), _corners(heights, inside + 1))


def _first(left: jax.Array) -> jax.Array:
    return jnp.floor(left / constants.TERRAIN_STEP).astype(jnp.int32)


def _boxes(boxes: Boxes | None, index: jax.Array) -> Boxes | None:
    """The boxes over stretches of the ground, each in the first of them alone."""
    if boxes is None:
        return None

    near: Boxes = jax.tree.map(lambda leaf: _taken(leaf, index), boxes)
    begins = (index == near.column) | (index == index.min(0))
    inside = (index >= 0) & (index < constants.NUM_EDGES)
    return Boxes(near.low, where(begins & inside, near.high, near.low))


def near_parts(terrain: Terrain, left: jax.Array) -> Near:
    """The four edges that each part of a leg may touch, from right to left, and the boxes on them.

    Box2D solves the newest contacts first, and a walker comes from the left.

    Args:
        terrain: the ground.
        left: where each part begins, its skin included [parts, B] [m].

    Returns:
        Edges and boxes [slots, parts, B].
    """
    index = _first(left) + jnp.arange(SLOTS, dtype=jnp.int32)[::-1, None, None]
    return Near(_edges(terrain.heights, index), _boxes(terrain.boxes, index))


def near_hull(terrain: Terrain, left: jax.Array) -> Near:
    """The edges and boxes that the hull may touch.

    Args:
        terrain: the ground.
        left: where the hull begins, its skin included [B] [m].

    Returns:
        Edges and boxes [edges, B].
    """
    index = _first(left) + jnp.arange(_HULL_EDGES, dtype=jnp.int32)[:, None]
    return Near(_edges(terrain.heights, index), _boxes(terrain.boxes, index))


def lidar(terrain: Terrain, place: Vec) -> jax.Array:
    """How far each of the ten rays gets, as a share of its length.

    Args:
        terrain: the ground.
        place: of the hull, [B] [m].

    Returns:
        Shares [10, B], 1 where a ray meets nothing.
    """
    index = _first(place.x) - 1 + jnp.arange(_WINDOW, dtype=jnp.int32)[:, None]
    kinds = [_edges(terrain.heights, index)]
    boxes = _boxes(terrain.boxes, index)
    if boxes is not None:
        kinds += boxes.sides()
    edges: Edges = jax.tree.map(lambda *leaves: jnp.stack(leaves, 1), *kinds)
    along = edges.end - edges.start
    square = dot(along, along)
    normal = tangent(along)
    away = edges.start - place
    above = dot(normal, away)
    shares = []
    for x, y in bipedal.LIDAR_REACH:
        span = math.ceil(x / constants.TERRAIN_STEP) + 3
        ray = Vec(jnp.float32(x), jnp.float32(y))
        share = above[:span] / dot(normal[:span], ray)
        on_edge = dot(ray * share - away[:span], along[:span])
        met = (share >= 0) & (share <= 1) & (on_edge >= 0) & (on_edge <= square[:span])
        shares.append(jnp.where(met & edges.exist[:span], share, 1.0).min((0, 1)))
    return jnp.stack(shares)
