"""Where the parts of the legs touch the ground: Box2D's manifolds of an edge and a polygon.

A part meets at most four edges of the ground at once; they stand in four slots. Arrays are [slots,
parts, B] where not said otherwise, those of a part alone [parts, B]: the batch is the last axis.

Source: E. Catto, "Contact Manifolds", GDC 2007, and the behaviour of Box2D 2.3's `b2EPCollider` for
an edge with no neighbours.
"""

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.geometry import Pose, Vec, dot, tangent, vec, where

Tree = TypeVar("Tree")

SKINS = 2 * constants.SKIN
SLOTS = 4
BEHIND_EDGES = constants.TERRAIN_LENGTH + 1
"""Numbers of boxes begin here (see `boxes`), those of edges end before it."""
AS_GOOD = 0.98
BETTER_BY = 0.001
"""A side of the part is taken for reference rather than the edge where it is better by so much."""

FACE = 64
"""In the key of a point that was not cut off. A key is a feature of the ground and eight times one
of the part, beside it."""


def polygon(corners: np.ndarray) -> tuple[Vec, Vec]:
    """Corners of a polygon and outward normals of its sides.

    Args:
        corners: counter-clockwise [..., corners, 2].

    Returns:
        The corners and, of the side from each to the next, the normal; [corners, ...].
    """
    along = np.roll(corners, -1, axis=-2) - corners
    normals = np.stack([along[..., 1], -along[..., 0]], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    first, second = (vec(np.moveaxis(values, -2, 0), 1) for values in (corners, normals))
    return first, second


CORNERS, NORMALS = polygon(constants.LEG_CORNERS[None])
"""Of the parts, [corners, 1 for the slots, parts, 1 for the batch]."""
NEXT_CORNERS = Vec(*(jnp.roll(axis, -1, 0) for axis in (CORNERS.x, CORNERS.y)))


def first_of(flags: jax.Array) -> jax.Array:
    """The first place on the first axis where a flag is set, int32; its length if none is."""
    count = flags.shape[0]
    places = jnp.arange(count, dtype=jnp.int32).reshape(-1, *[1] * (flags.ndim - 1))
    return jnp.where(flags, places, count).min(0)


def pick(place: jax.Array, values: Vec) -> Vec:
    """The vector at a place of the first axis.

    Args:
        place: int32 [...].
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
    """Edges of the ground near each part, from left to right.

    Attributes:
        index: which of the terrain's, int32; below 0 or beyond the last there is none.
        start: left corners [m].
        end: right corners [m].
    """

    index: jax.Array
    start: Vec
    end: Vec

    @property
    def exist(self) -> jax.Array:
        """Which of them are of the terrain."""
        return (self.index >= 0) & (self.index < constants.NUM_EDGES)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Manifold:
    """How a part touches an edge, in at most two points.

    Attributes:
        edge: which of the terrain's, or which box, int32.
        on_edge: whether the edge is the reference, and the points are of the part; else a side of
            the part is, and the points are of the edge.
        normal: of the reference; in the world where `on_edge`, else in the part.
        plane: a point of the reference; likewise.
        points: two; in the part where `on_edge`, else in the world.
        keys: of the two points, which tell whether a point is that of the step before, int32.
        valid: which of them there are, bool.
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

    def look(self, part: Pose) -> list[tuple[Vec, Vec, jax.Array]]:
        """The contact with the part at a pose.

        Args:
            part: [parts, B].

        Returns:
            For each of the two points: the normal from the ground to the part, the point in the
            world [m], and how far the two are apart there [m].
        """
        normal = where(self.on_edge, self.normal, part.turned(self.normal))
        plane = where(self.on_edge, self.plane, part.put(self.plane))
        points = [where(self.on_edge, part.put(point), point) for point in self.points]
        outward = where(self.on_edge, normal, -normal)
        return [(outward, point, dot(point - plane, normal) - SKINS) for point in points]


def touch(part: Pose, edges: Edges) -> Manifold:
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
    up = where(front, below, -below)
    corners, normals = part.put(CORNERS), part.turned(NORMALS)
    next_corners = part.put(NEXT_CORNERS)

    of_edge = dot(up, corners - edges.start).min(0)
    of_sides = -jnp.maximum(dot(normals, corners - edges.start), dot(normals, corners - edges.end))
    of_side = of_sides.max(0)
    near = (of_edge <= SKINS) & (of_side <= SKINS) & edges.exist
    on_edge = of_side <= AS_GOOD * of_edge + BETTER_BY

    facing = dot(up, normals)
    side = jnp.where(on_edge, first_of(facing <= facing.min(0)), first_of(of_sides >= of_side))
    side = once(side)
    corner, following, outward = (pick(side, v) for v in (corners, next_corners, normals))

    # The segment that is clipped, and the reference that it is clipped to.
    first, second = where(on_edge, corner, edges.start), where(on_edge, following, edges.end)
    left = where(on_edge, where(front, edges.start, edges.end), corner)
    right = where(on_edge, where(front, edges.end, edges.start), following)
    normal = where(on_edge, up, outward)
    next_side = (side + 1) % 4
    zero = jnp.zeros_like(side)
    # A key is made of a feature of the edge, one of the part, and which of the two is a side.
    keys = [
        jnp.where(on_edge, 8 * side + FACE, side + FACE),
        jnp.where(on_edge, 8 * next_side + FACE, side + FACE),
    ]
    incident = jnp.where(on_edge, side, zero)
    points = [first, second]
    met = near
    for border, outside, feature in (
        (left, tangent(normal), jnp.where(on_edge, jnp.where(front, 0, 1), side)),
        (right, -tangent(normal), jnp.where(on_edge, jnp.where(front, 1, 0), next_side)),
    ):
        cut = jnp.where(on_edge, feature + 8 * incident, side + 8 * feature)
        points, keys, cuts, incident = clip(points, keys, incident, border, outside, cut)
        met = met & cuts

    valid = [met & (dot(normal, point - left) <= SKINS) for point in points]
    return Manifold(
        edge=edges.index,
        on_edge=on_edge,
        normal=where(on_edge, normal, pick(side, NORMALS)),
        plane=where(on_edge, left, pick(side, CORNERS)),
        points=(
            where(on_edge, part.took(points[0]), points[0]),
            where(on_edge, part.took(points[1]), points[1]),
        ),
        keys=(keys[0], keys[1]),
        valid=(valid[0], valid[1]),
    )


def clip(
    points: list[Vec],
    keys: list[jax.Array],
    incident: jax.Array,
    border: Vec,
    outside: Vec,
    cut: jax.Array,
) -> tuple[list[Vec], list[jax.Array], jax.Array, jax.Array]:
    """Cuts a segment off at a border (Sutherland and Hodgman).

    Args:
        points: its ends.
        keys: of these.
        incident: the feature of the second polygon that the first of them has.
        border: a point of it.
        outside: its normal.
        cut: the key of a point that is made here.

    Returns:
        The points, their keys, whether two are left, and the part's feature of the first of them.
    """
    first, second = (dot(outside, point - border) for point in points)
    share = first / jnp.where(first == second, 1.0, first - second)
    crossing = points[0] + (points[1] - points[0]) * share
    both = (first <= 0) & (second <= 0)
    keeps_first = first <= 0
    left = [where(keeps_first, points[0], points[1]), where(both, points[1], crossing)]
    names = [jnp.where(keeps_first, keys[0], keys[1]), jnp.where(both, keys[1], cut)]
    second_feature = (keys[1] // 8) % 8
    feature = jnp.where(keeps_first, incident, second_feature)
    return left, names, both | (first * second < 0), feature


def _by_type(function: Callable[[jax.Array], jax.Array], tree: Tree) -> Tree:
    """A function of arrays of one shape, done to all of one type as one stack: a small program."""
    leaves, structure = jax.tree.flatten(tree)
    results: dict[int, jax.Array] = {}
    for dtype in {leaf.dtype: None for leaf in leaves}:
        places = [place for place, leaf in enumerate(leaves) if leaf.dtype == dtype]
        done = function(jnp.stack([leaves[place] for place in places]))
        results |= zip(places, done, strict=True)
    result: Tree = jax.tree.unflatten(structure, [results[place] for place in range(len(leaves))])
    return result


def forward(manifold: Manifold, leading: jax.Array | bool = False) -> Manifold:
    """Moves those that touch to the first slots, in the order in which they stand.

    Args:
        manifold: of at least `SLOTS` slots; no more than these are kept.
        leading: which of them go before the others, if they touch.

    Returns:
        The same, in other slots.
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

    return once(_by_type(moved, manifold))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Contacts:
    """What is remembered of contacts from step to step.

    Attributes:
        edge: the edge in each slot, int32.
        keys: of the two points.
        valid: which of them there are.
        normal: impulses along the normal [N s], of the two points.
        along: impulses of friction [N s], of the two points.
    """

    edge: jax.Array
    keys: tuple[jax.Array, jax.Array]
    valid: tuple[jax.Array, jax.Array]
    normal: tuple[jax.Array, jax.Array]
    along: tuple[jax.Array, jax.Array]

    @property
    def touching(self) -> jax.Array:
        """Whether there is a point."""
        return self.valid[0] | self.valid[1]


def no_contacts(batch: int) -> Contacts:
    """Those of a walker in the air; [4, 4, B]."""
    none = jnp.zeros((4, 4, batch), jnp.int32)
    no = jnp.zeros((4, 4, batch), bool)
    zero = jnp.zeros((4, 4, batch), jnp.float32)
    return Contacts(none - 1, (none, none), (no, no), (zero, zero), (zero, zero))


def remember(old: Contacts, manifold: Manifold) -> Contacts:
    """New contacts with the impulses of those points that were there before.

    Args:
        old: contacts before.
        manifold: of the slots now.

    Returns:
        The contacts now.
    """
    before = _found(old, manifold.edge)

    def matched(key: jax.Array, values: tuple[jax.Array, jax.Array]) -> jax.Array:
        is_first, is_second = (
            valid & (old_key == key)
            for valid, old_key in zip(before.valid, before.keys, strict=True)
        )
        return jnp.where(is_first, values[0], jnp.where(is_second, values[1], 0.0))

    one, two = manifold.keys
    return Contacts(
        manifold.edge,
        manifold.keys,
        manifold.valid,
        (matched(one, before.normal), matched(two, before.normal)),
        (matched(one, before.along), matched(two, before.along)),
    )


def _found(contacts: Contacts, index: jax.Array) -> Contacts:
    """Contacts in the slots of given edges; those of other edges are without a point."""

    def found(leaves: jax.Array) -> jax.Array:
        result = jnp.zeros_like(leaves)
        for slot in range(SLOTS):
            result = jnp.where(contacts.edge[slot] == index, leaves[:, slot, None], result)
        return result

    return dataclasses.replace(_by_type(found, contacts), edge=index)


def feet_after(feet: jax.Array, old: Contacts, new: Contacts) -> jax.Array:
    """Whether each part stands, as gymnasium hears of it from Box2D.

    Each contact that begins says yes, each that ends says no, also where another goes on; the last
    word counts, which is that of the contact most to the left.

    Args:
        feet: before, bool [parts, B].
        old: contacts before.
        new: contacts now.

    Returns:
        Feet now, bool [parts, B].
    """
    begins = new.touching & ~_found(old, new.edge).touching
    ends = old.touching & ~_found(new, old.edge).touching
    far = jnp.int32(BEHIND_EDGES)
    begun = jnp.where(begins, new.edge % BEHIND_EDGES, far).min(0)
    ended = jnp.where(ends, old.edge % BEHIND_EDGES, far).min(0)
    last = jnp.minimum(begun, ended)
    return jnp.where(last == far, feet, begun <= ended)
