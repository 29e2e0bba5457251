"""What stands on hardcore ground: upright boxes, and how the legs' parts touch them.

Arrays are [slots, parts, B] where not said otherwise, those of parts alone [parts, B]. See `touch`
for the edges of the ground.

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
from hitl_jax.walker.physics import manifolds as touch
from hitl_jax.walker.physics.manifolds import FACE, SKINS, Edges, Manifold, first_of, pick

_UPRIGHT = vec(np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]), 3)
"""Normals of a box's sides, as Box2D numbers them: it begins at the right bottom corner."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Boxes:
    """Upright boxes, of any shape.

    Attributes:
        low: left bottom corners [m].
        high: right top corners [m]; not to the right of the others where there is no box.
    """

    low: Vec
    high: Vec

    @property
    def exist(self) -> jax.Array:
        """Where there is a box."""
        return self.high.x > self.low.x

    @property
    def column(self) -> jax.Array:
        """The edge of the ground at which each begins, int32."""
        return jnp.round(self.low.x / constants.TERRAIN_STEP).astype(jnp.int32)

    @property
    def index(self) -> jax.Array:
        """Numbers of the boxes, which edges of the ground do not have, int32."""
        return touch.BEHIND_EDGES + self.column

    @property
    def corners(self) -> Vec:
        """All four, in the order of Box2D, [4, ...]."""
        low, high = self.low, self.high
        return Vec(
            jnp.stack([high.x, high.x, low.x, low.x]), jnp.stack([low.y, high.y, high.y, low.y])
        )

    def gap(self, corners: Vec) -> jax.Array:
        """How far polygons are outside of one side of the boxes, at most [...] [m].

        Args:
            corners: [corners, ...].
        """
        return self._gaps(corners).max(0)

    def _gaps(self, corners: Vec) -> jax.Array:
        """The same, for each of the sides [4, ...]."""
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


def manifolds(part: Pose, boxes: Boxes) -> Manifold:
    """The manifolds of parts and boxes.

    Args:
        part: [parts, B].
        boxes: [slots, parts, B].

    Returns:
        Manifolds, [slots, parts, B]; `on_edge` is "on the box" here.
    """
    corners, normals = part.put(touch.CORNERS), part.turned(touch.NORMALS)
    next_corners = part.put(touch.NEXT_CORNERS)
    others = boxes.corners

    of_sides = boxes._gaps(corners)
    of_box = of_sides.max(0)
    depths = dot(normals[None], others[:, None] - corners[None]).min(0)
    of_part = depths.max(0)
    near = (of_box <= SKINS) & (of_part <= SKINS) & boxes.exist
    on_box = of_part <= touch.AS_GOOD * of_box + touch.BETTER_BY

    best = once((first_of(of_sides >= of_box), first_of(depths >= of_part)))
    of_normal, part_normal = pick(best[0], _UPRIGHT), pick(best[1], normals)
    facing = dot(of_normal, normals), dot(part_normal, _UPRIGHT)
    opposite = [first_of(values <= values.min(0)) for values in facing]
    box_side = once(jnp.where(on_box, best[0], opposite[1]))
    side = once(jnp.where(on_box, opposite[0], best[1]))
    of_box_side = pick(box_side, others), pick((box_side + 1) % 4, others)
    of_part_side = pick(side, corners), pick(side, next_corners)

    # The segment that is clipped, and the reference that it is clipped to.
    left, right = (where(on_box, a, b) for a, b in zip(of_box_side, of_part_side, strict=True))
    points = [where(on_box, b, a) for a, b in zip(of_box_side, of_part_side, strict=True)]
    normal = where(on_box, of_normal, part_normal)
    reference, incident = (
        jnp.where(on_box, box_side, side),
        jnp.where(on_box, side, box_side),
    )
    keys = [reference + 8 * incident + FACE, reference + 8 * ((incident + 1) % 4) + FACE]
    met = near
    for end, outside, feature in (
        (left, tangent(normal), reference),
        (right, -tangent(normal), (reference + 1) % 4),
    ):
        border, cut = end + outside * SKINS, feature + 8 * incident
        points, keys, cuts, incident = touch.clip(points, keys, incident, border, outside, cut)
        met = met & cuts

    valid = [met & (dot(normal, point - left) <= SKINS) for point in points]
    keys = [jnp.where(on_box, key, _swapped(key)) for key in keys]
    return Manifold(
        edge=boxes.index,
        on_edge=on_box,
        normal=where(on_box, normal, pick(side, touch.NORMALS)),
        plane=where(on_box, left, pick(side, touch.CORNERS)),
        points=(
            where(on_box, part.took(points[0]), points[0]),
            where(on_box, part.took(points[1]), points[1]),
        ),
        keys=(keys[0], keys[1]),
        valid=(valid[0], valid[1]),
    )


def _swapped(key: jax.Array) -> jax.Array:
    """A key with its two features the other way round."""
    return (key // 8) % 8 + 8 * (key % 8) + FACE * (1 - key // FACE)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Near:
    """What each part may touch.

    Attributes:
        edges: of the ground.
        boxes: on it; None on plain terrain.
    """

    edges: Edges
    boxes: Boxes | None

    @property
    def index(self) -> jax.Array:
        """Numbers of the edges, and then of the boxes."""
        if self.boxes is None:
            return self.edges.index
        return jnp.concatenate([self.edges.index, self.boxes.index])

    def touch(self, part: Pose) -> Manifold:
        """The manifolds with parts [parts, B], in the same order."""
        of_edges = touch.touch(part, self.edges)
        if self.boxes is None:
            return of_edges
        result: Manifold = jax.tree.map(
            lambda *leaves: jnp.concatenate(leaves), of_edges, manifolds(part, self.boxes)
        )
        return result
