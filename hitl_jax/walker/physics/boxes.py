"""Obstacles on hardcore ground: upright boxes, and their manifolds with the legs' parts.

Arrays are [slots, parts, B] where not said otherwise, those of parts alone [parts, B]. See
`manifolds` for the edges of the ground.

Source: E. Catto, "Contact Manifolds", GDC 2007, and the behaviour of Box2D 2.3's
`b2CollidePolygons`.
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.geometry import Pose, Vec, dot, tangent, vec, where
from hitl_jax.walker.physics.manifolds import (
    ABSOLUTE_TOLERANCE,
    CORNERS,
    FACE,
    FIRST_BOX,
    NEXT_CORNERS,
    NORMALS,
    RELATIVE_TOLERANCE,
    TOTAL_RADIUS,
    Edges,
    Manifold,
    clip,
    edge_manifolds,
    first_of,
    manifold_of,
    pick,
)

_BOX_NORMALS = vec(np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]), 3)
"""Normals of a box's sides, as Box2D numbers them: it begins at the right bottom corner."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Boxes:
    """Upright boxes, in arrays of any shape.

    Attributes:
        low: left bottom corners [m].
        high: right top corners [m]; not to the right of `low` where there is no box.
    """

    low: Vec
    high: Vec

    @property
    def exist(self) -> jax.Array:
        """Where there is a box."""
        return self.high.x > self.low.x

    @property
    def column(self) -> jax.Array:
        """The edge of the ground at which each box begins, int32."""
        return jnp.round(self.low.x / constants.TERRAIN_STEP).astype(jnp.int32)

    @property
    def index(self) -> jax.Array:
        """Numbers of the boxes; no edge of the ground has one of these, int32."""
        return FIRST_BOX + self.column

    @property
    def corners(self) -> Vec:
        """All four corners, in the order of Box2D, [4, ...] [m]."""
        low, high = self.low, self.high
        return Vec(
            jnp.stack([high.x, high.x, low.x, low.x]), jnp.stack([low.y, high.y, high.y, low.y])
        )

    def separation(self, corners: Vec) -> jax.Array:
        """The largest distance of polygons from a side of the boxes, along its normal [...] [m].

        Args:
            corners: of the polygons, in the world [corners, ...] [m].
        """
        return self.side_separations(corners).max(0)

    def side_separations(self, corners: Vec) -> jax.Array:
        """The distance of polygons from each side of the boxes, along its normal [4, ...] [m]."""
        return jnp.stack(
            [
                corners.x.min(0) - self.high.x,
                corners.y.min(0) - self.high.y,
                self.low.x - corners.x.max(0),
                self.low.y - corners.y.max(0),
            ]
        )

    def sides(self) -> list[Edges]:
        """Left, upper and right sides; the lower one is in the ground."""
        left = Vec(self.low.x, self.high.y)
        right = Vec(self.high.x, self.low.y)
        index = jnp.where(self.exist, 0, -1)
        around = [self.low, left, self.high, right]
        return [Edges(index, *ends) for ends in itertools.pairwise(around)]


def box_manifolds(part: Pose, boxes: Boxes) -> Manifold:
    """The manifolds of parts and boxes.

    Args:
        part: [parts, B].
        boxes: [slots, parts, B].

    Returns:
        Manifolds, [slots, parts, B]; `on_edge` says that the reference is a side of the box.
    """
    corners, normals = part.world_point(CORNERS), part.world_vector(NORMALS)
    next_corners = part.world_point(NEXT_CORNERS)
    box_corners = boxes.corners

    of_sides = boxes.side_separations(corners)
    of_box = of_sides.max(0)
    depths = dot(normals[None], box_corners[:, None] - corners[None]).min(0)
    of_part = depths.max(0)
    overlap = (of_box <= TOTAL_RADIUS) & (of_part <= TOTAL_RADIUS) & boxes.exist
    on_box = of_part <= RELATIVE_TOLERANCE * of_box + ABSOLUTE_TOLERANCE

    best = once((first_of(of_sides >= of_box), first_of(depths >= of_part)))
    box_normal, part_normal = pick(best[0], _BOX_NORMALS), pick(best[1], normals)
    facing = dot(box_normal, normals), dot(part_normal, _BOX_NORMALS)
    opposite = [first_of(values <= values.min(0)) for values in facing]
    box_side = once(jnp.where(on_box, best[0], opposite[1]))
    side = once(jnp.where(on_box, opposite[0], best[1]))
    of_box_side = pick(box_side, box_corners), pick((box_side + 1) % 4, box_corners)
    of_part_side = pick(side, corners), pick(side, next_corners)

    # The ends of the reference face, and the incident segment that is clipped at them.
    left, right = (where(on_box, a, b) for a, b in zip(of_box_side, of_part_side, strict=True))
    points = [where(on_box, b, a) for a, b in zip(of_box_side, of_part_side, strict=True)]
    normal = where(on_box, box_normal, part_normal)
    reference = jnp.where(on_box, box_side, side)
    incident = jnp.where(on_box, side, box_side)
    keys = [reference + 8 * incident + FACE, reference + 8 * ((incident + 1) % 4) + FACE]
    for end, outside, feature in (
        (left, tangent(normal), reference),
        (right, -tangent(normal), (reference + 1) % 4),
    ):
        limit, key = end + outside * TOTAL_RADIUS, feature + 8 * incident
        points, keys, both_left, incident = clip(points, keys, incident, limit, outside, key)
        overlap = overlap & both_left

    valid = [overlap & (dot(normal, point - left) <= TOTAL_RADIUS) for point in points]
    keys = [jnp.where(on_box, key, _swapped(key)) for key in keys]
    return manifold_of(part, boxes.index, on_box, (normal, left), side, points, keys, valid)


def _swapped(key: jax.Array) -> jax.Array:
    """A key with its two features exchanged."""
    return (key // 8) % 8 + 8 * (key % 8) + FACE * (1 - key // FACE)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class NearbyGround:
    """The edges and boxes that each part may touch.

    Attributes:
        edges: of the ground, [slots, parts, B].
        boxes: on it, [slots, parts, B]; None on plain terrain.
    """

    edges: Edges
    boxes: Boxes | None

    @property
    def index(self) -> jax.Array:
        """Numbers of the edges, and then of the boxes, int32 [slots or 2 slots, parts, B]."""
        if self.boxes is None:
            return self.edges.index
        return jnp.concatenate([self.edges.index, self.boxes.index])

    def manifolds(self, part: Pose) -> Manifold:
        """The manifolds of parts [parts, B] with the edges, and then with the boxes."""
        of_edges = edge_manifolds(part, self.edges)
        if self.boxes is None:
            return of_edges
        result: Manifold = jax.tree.map(
            lambda *leaves: jnp.concatenate(leaves), of_edges, box_manifolds(part, self.boxes)
        )
        return result
