"""Contact manifolds of the legs' parts and the ground's edges, as Box2D computes them.

A part (thigh or shin) touches at most four edges of the ground at once; each has one of four
slots. Arrays are [slots, parts, B] where not said otherwise, those of a part alone [parts, B]:
the batch is the last axis.

Source: E. Catto, "Contact Manifolds", GDC 2007, and the behaviour of Box2D 2.3's `b2EPCollider` for
an edge with no neighbours.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.batching.stacked_leaves import map_stacked
from hitl_jax.walker.geometry import Pose, Vec, dot, tangent, vec, where

TOTAL_RADIUS = 2 * constants.POLYGON_RADIUS
"""Separation of two cores at which their skins meet [m] (Box2D's `totalRadius`)."""
SLOTS = 4
"""Manifolds that a part can have at once."""
FIRST_BOX = constants.TERRAIN_LENGTH + 1
"""Numbers of boxes begin here (see `boxes`), those of edges end before it."""
RELATIVE_TOLERANCE = 0.98
ABSOLUTE_TOLERANCE = 0.001
"""A side of the part becomes the reference instead of the edge only where its separation is larger
by so much."""

FACE = 64
"""Added to the key of a point that was not clipped. A key is a feature of the ground plus eight
times a feature of the part; a feature is a corner or a side by its number."""


def polygon(corners: np.ndarray) -> tuple[Vec, Vec]:
    """Corners of a polygon and outward normals of its sides.

    Args:
        corners: counter-clockwise [..., corners, 2] [m].

    Returns:
        The corners [m], and the unit normal of the side from each corner to the next; both
        [corners, ...].
    """
    along = np.roll(corners, -1, axis=-2) - corners
    normals = np.stack([along[..., 1], -along[..., 0]], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    first, second = (vec(np.moveaxis(values, -2, 0), 1) for values in (corners, normals))
    return first, second


CORNERS, NORMALS = polygon(constants.LEG_CORNERS[None])
"""Of the parts, in their own frames, [corners, 1 for the slots, parts, 1 for the batch]."""
NEXT_CORNERS = Vec(*(jnp.roll(axis, -1, 0) for axis in (CORNERS.x, CORNERS.y)))


def first_of(flags: jax.Array) -> jax.Array:
    """The first index of the first axis whose flag is set, int32; the axis's length if none is."""
    count = flags.shape[0]
    places = jnp.arange(count, dtype=jnp.int32).reshape(-1, *[1] * (flags.ndim - 1))
    return jnp.where(flags, places, count).min(0)


def pick(place: jax.Array, values: Vec) -> Vec:
    """The vector at an index of the first axis.

    Args:
        place: the index, int32 [...].
        values: [places, ...], axes of length 1 allowed.

    Returns:
        Vectors [...].
    """
    count = values.x.shape[0]
    chosen = place == jnp.arange(count, dtype=jnp.int32).reshape(-1, *[1] * place.ndim)
    return Vec(*(jnp.where(chosen, axis, 0.0).sum(0) for axis in (values.x, values.y)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Edges:
    """Edges of the ground near each part.

    Attributes:
        index: which of the terrain's edges, int32; below 0 or beyond the last there is none.
        start: left corners [m].
        end: right corners [m].
    """

    index: jax.Array
    start: Vec
    end: Vec

    @property
    def exist(self) -> jax.Array:
        """Which of them are edges of the terrain."""
        return (self.index >= 0) & (self.index < constants.NUM_EDGES)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Manifold:
    """Where a part touches an edge or a box: at most two points (`b2Manifold`).

    Attributes:
        edge: number of the terrain's edge, or of the box, int32.
        on_edge: whether the reference face is the edge's (or the box's) and the points are the
            part's; else the reference is a side of the part and the points are the ground's.
        normal: of the reference face; in the world where `on_edge`, else in the part's frame.
        plane: a point of the reference face; in the same frame [m].
        points: two; in the part's frame where `on_edge`, else in the world [m].
        keys: of the two points (`b2ContactID`): equal keys in two steps are the same point, int32.
        valid: which of the two points exist, bool.
    """

    edge: jax.Array
    on_edge: jax.Array
    normal: Vec
    plane: Vec
    points: tuple[Vec, Vec]
    keys: tuple[jax.Array, jax.Array]
    valid: tuple[jax.Array, jax.Array]

    @property
    def touching(self) -> jax.Array:
        """Whether there is a point."""
        return self.valid[0] | self.valid[1]

    def in_world(self, part: Pose) -> list[tuple[Vec, Vec, jax.Array]]:
        """The two points in the world, with the part at a pose (`b2WorldManifold`).

        Args:
            part: [parts, B].

        Returns:
            For each of the two points: the normal from the ground to the part, the point in the
            world [m], and the separation of the skins there, negative where they overlap [m].
        """
        normal = where(self.on_edge, self.normal, part.world_vector(self.normal))
        plane = where(self.on_edge, self.plane, part.world_point(self.plane))
        points = [where(self.on_edge, part.world_point(point), point) for point in self.points]
        outward = where(self.on_edge, normal, -normal)
        return [(outward, point, dot(point - plane, normal) - TOTAL_RADIUS) for point in points]


def edge_manifolds(part: Pose, edges: Edges) -> Manifold:
    """The manifolds of parts and edges.

    Args:
        part: [parts, B].
        edges: [slots, parts, B].

    Returns:
        Manifolds, [slots, parts, B].
    """
    along = edges.end - edges.start
    below = tangent(along * (1.0 / jnp.sqrt(dot(along, along))))
    front = dot(below, part.place - edges.start) >= 0
    edge_normal = where(front, below, -below)
    corners, normals = part.world_point(CORNERS), part.world_vector(NORMALS)
    next_corners = part.world_point(NEXT_CORNERS)

    of_edge = dot(edge_normal, corners - edges.start).min(0)
    of_sides = -jnp.maximum(dot(normals, corners - edges.start), dot(normals, corners - edges.end))
    of_side = of_sides.max(0)
    overlap = (of_edge <= TOTAL_RADIUS) & (of_side <= TOTAL_RADIUS) & edges.exist
    on_edge = of_side <= RELATIVE_TOLERANCE * of_edge + ABSOLUTE_TOLERANCE

    facing = dot(edge_normal, normals)
    side = jnp.where(on_edge, first_of(facing <= facing.min(0)), first_of(of_sides >= of_side))
    side = once(side)
    corner, following, outward = (pick(side, v) for v in (corners, next_corners, normals))

    # The incident segment, which is clipped, and the ends of the reference face that clip it.
    first, second = where(on_edge, corner, edges.start), where(on_edge, following, edges.end)
    left = where(on_edge, where(front, edges.start, edges.end), corner)
    right = where(on_edge, where(front, edges.end, edges.start), following)
    normal = where(on_edge, edge_normal, outward)
    next_side = (side + 1) % 4
    zero = jnp.zeros_like(side)
    keys = [
        jnp.where(on_edge, 8 * side + FACE, side + FACE),
        jnp.where(on_edge, 8 * next_side + FACE, side + FACE),
    ]
    incident = jnp.where(on_edge, side, zero)
    points = [first, second]
    for end, outside, feature in (
        (left, tangent(normal), jnp.where(on_edge, jnp.where(front, 0, 1), side)),
        (right, -tangent(normal), jnp.where(on_edge, jnp.where(front, 1, 0), next_side)),
    ):
        key = jnp.where(on_edge, feature + 8 * incident, side + 8 * feature)
        points, keys, both_left, incident = clip(points, keys, incident, end, outside, key)
        overlap = overlap & both_left

    valid = [overlap & (dot(normal, point - left) <= TOTAL_RADIUS) for point in points]
    return manifold_of(part, edges.index, on_edge, (normal, left), side, points, keys, valid)


def manifold_of(
    part: Pose,
    index: jax.Array,
    on_edge: jax.Array,
    reference: tuple[Vec, Vec],
    side: jax.Array,
    points: list[Vec],
    keys: list[jax.Array],
    valid: list[jax.Array],
) -> Manifold:
    """A manifold from what was found in the world; each vector goes into the frame that keeps it.

    Args:
        part: [parts, B].
        index: number of the edge or box.
        on_edge: whether the reference face is the ground's.
        reference: normal and a point of the reference face, in the world.
        side: of the part: the reference where not `on_edge`, int32.
        points: two, in the world [m].
        keys: of the points.
        valid: which points exist.
    """
    normal, plane = reference
    return Manifold(
        edge=index,
        on_edge=on_edge,
        normal=where(on_edge, normal, pick(side, NORMALS)),
        plane=where(on_edge, plane, pick(side, CORNERS)),
        points=(
            where(on_edge, part.local_point(points[0]), points[0]),
            where(on_edge, part.local_point(points[1]), points[1]),
        ),
        keys=(keys[0], keys[1]),
        valid=(valid[0], valid[1]),
    )


def clip(
    points: list[Vec],
    keys: list[jax.Array],
    incident: jax.Array,
    end: Vec,
    outside: Vec,
    key: jax.Array,
) -> tuple[list[Vec], list[jax.Array], jax.Array, jax.Array]:
    """Clips a segment at a line (Sutherland and Hodgman; `b2ClipSegmentToLine`).

    Args:
        points: the segment's two ends [m].
        keys: of the two ends.
        incident: the feature of the incident polygon at the first end.
        end: a point of the line [m].
        outside: the line's normal, towards what is cut off.
        key: of the point in which the segment crosses the line.

    Returns:
        The points, their keys, whether two are left, and the incident polygon's feature at the
        first of them.
    """
    first, second = (dot(outside, point - end) for point in points)
    share = first / jnp.where(first == second, 1.0, first - second)
    crossing = points[0] + (points[1] - points[0]) * share
    both = (first <= 0) & (second <= 0)
    keeps_first = first <= 0
    left = [where(keeps_first, points[0], points[1]), where(both, points[1], crossing)]
    left_keys = [jnp.where(keeps_first, keys[0], keys[1]), jnp.where(both, keys[1], key)]
    second_feature = (keys[1] // 8) % 8
    feature = jnp.where(keeps_first, incident, second_feature)
    return left, left_keys, both | (first * second < 0), feature


def touching_first(manifold: Manifold, leading: jax.Array | bool = False) -> Manifold:
    """Moves the touching manifolds to the first slots and keeps their order.

    Args:
        manifold: of at least `SLOTS` slots; no more than these are kept.
        leading: which of them go before the others, if they touch.

    Returns:
        The same manifolds in `SLOTS` slots.
    """
    manifold = once(manifold)
    touching = manifold.touching
    groups = (touching & leading, touching & ~jnp.asarray(leading), ~touching)
    slot = jnp.zeros_like(manifold.edge)
    taken = jnp.zeros_like(slot[0])
    for group in groups:
        members = group.astype(jnp.int32)
        before = jnp.cumsum(members, axis=0, dtype=jnp.int32) - members
        slot = jnp.where(group, taken + before, slot)
        taken = taken + members.sum(0, dtype=jnp.int32)
    slot = once(slot)

    slots = jnp.arange(SLOTS, dtype=jnp.int32)[:, None, None]

    def moved(leaves: jax.Array) -> jax.Array:
        *rows, last = (leaves[:, i, None] for i in range(leaves.shape[1]))
        result = jnp.broadcast_to(last, (len(leaves), SLOTS, *slot.shape[1:]))
        for row, to in zip(rows, slot[:-1], strict=True):
            result = jnp.where(to == slots, row, result)
        return result

    return once(map_stacked(moved, manifold))
