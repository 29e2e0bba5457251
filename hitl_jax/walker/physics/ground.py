"""The edges and boxes near a body, and the lidar's distances to the ground.

Terrain is [TERRAIN_LENGTH, B], one corner every `TERRAIN_STEP`; the batch is the last axis.
"""

import math

import jax
import jax.numpy as jnp

from hitl_jax.walker import bipedal, constants
from hitl_jax.walker.geometry import Vec, dot, tangent, where
from hitl_jax.walker.physics.boxes import Boxes, NearbyGround
from hitl_jax.walker.physics.manifolds import SLOTS, Edges
from hitl_jax.walker.terrain import Terrain

_HULL_EDGES = 6
"""More edges than the hull can touch at once."""

_LIDAR_EDGES = math.ceil(bipedal.LIDAR_REACH[-1][0] / constants.TERRAIN_STEP) + 3
"""Edges that a ray may hit, with one more on either side."""


def _corners(heights: jax.Array, index: jax.Array) -> Vec:
    """Corners of the ground by their numbers [..., B] [m]."""
    inside = jnp.clip(index, 0, constants.NUM_EDGES)
    return Vec(jnp.asarray(constants.CORNER_X)[inside], _gathered(heights, inside))


def _gathered(leaf: jax.Array, index: jax.Array) -> jax.Array:
    """Entries of each walker's terrain [TERRAIN_LENGTH, B] by their numbers, [..., B]."""
    flat = jnp.clip(index, 0, constants.NUM_EDGES).reshape(-1, index.shape[-1])
    return jnp.take_along_axis(leaf, flat, axis=0, mode="clip").reshape(index.shape)


def _edges(heights: jax.Array, index: jax.Array) -> Edges:
    """Edges of the ground by their numbers [..., B]."""
    inside = jnp.clip(index, 0, constants.NUM_EDGES - 1)
    return Edges(index, _corners(heights, inside), _corners(heights, inside + 1))


def _edge_at(x: jax.Array) -> jax.Array:
    """Number of the edge over which a point stands, int32."""
    return jnp.floor(x / constants.TERRAIN_STEP).astype(jnp.int32)


def _boxes(boxes: Boxes | None, index: jax.Array) -> Boxes | None:
    """The boxes over edges of the ground; a box over several edges is at the first of them."""
    if boxes is None:
        return None

    near: Boxes = jax.tree.map(lambda leaf: _gathered(leaf, index), boxes)
    begins = (index == near.column) | (index == index.min(0))
    inside = (index >= 0) & (index < constants.NUM_EDGES)
    return Boxes(near.low, where(begins & inside, near.high, near.low))


def near_parts(terrain: Terrain, left: jax.Array) -> NearbyGround:
    """The four edges that each part of a leg may touch, from right to left, and the boxes on them.

    Box2D solves the newest contacts first, and a walker comes from the left.

    Args:
        terrain: leaves [TERRAIN_LENGTH, B].
        left: left end of each part, its skin included [parts, B] [m].

    Returns:
        Edges and boxes [slots, parts, B].
    """
    index = _edge_at(left) + jnp.arange(SLOTS, dtype=jnp.int32)[::-1, None, None]
    return NearbyGround(_edges(terrain.heights, index), _boxes(terrain.boxes, index))


def near_hull(terrain: Terrain, left: jax.Array) -> NearbyGround:
    """The edges and boxes that the hull may touch.

    Args:
        terrain: leaves [TERRAIN_LENGTH, B].
        left: left end of the hull, its skin included [B] [m].

    Returns:
        Edges and boxes [edges, B].
    """
    index = _edge_at(left) + jnp.arange(_HULL_EDGES, dtype=jnp.int32)[:, None]
    return NearbyGround(_edges(terrain.heights, index), _boxes(terrain.boxes, index))


def lidar(terrain: Terrain, place: Vec) -> jax.Array:
    """Where each of the ten lidar rays hits the ground, as a fraction of the ray's length.

    Args:
        terrain: leaves [TERRAIN_LENGTH, B].
        place: of the hull, where the rays start [B] [m].

    Returns:
        Fractions [10, B], 1 where a ray hits nothing.
    """
    index = _edge_at(place.x) - 1 + jnp.arange(_LIDAR_EDGES, dtype=jnp.int32)[:, None]
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
    fractions = []
    for x, y in bipedal.LIDAR_REACH:
        span = math.ceil(x / constants.TERRAIN_STEP) + 3
        ray = Vec(jnp.float32(x), jnp.float32(y))
        fraction = above[:span] / dot(normal[:span], ray)
        on_edge = dot(ray * fraction - away[:span], along[:span])
        hits = (fraction >= 0) & (fraction <= 1) & (on_edge >= 0) & (on_edge <= square[:span])
        fractions.append(jnp.where(hits & edges.exist[:span], fraction, 1.0).min((0, 1)))
    return jnp.stack(fractions)
