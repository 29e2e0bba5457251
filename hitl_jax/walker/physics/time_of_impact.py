"""Time of impact: when parts that would enter the ground within a step first touch it.

Arrays are [slots, parts, B] where not said otherwise, those of parts alone [parts, B].

Source: E. Catto, "Continuous Collision", GDC 2013, and the behaviour of Box2D 2.3's
`b2TimeOfImpact`.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.geometry import Pose, Vec, cross, dot, pose, tangent, where
from hitl_jax.walker.physics.boxes import NearbyGround
from hitl_jax.walker.physics.manifolds import CORNERS, NEXT_CORNERS, NORMALS, Edges, first_of, pick

_TARGET = constants.LINEAR_SLOP
"""Separation of the cores at an impact [m]: the total radius less three slops."""
_TOLERANCE = 0.25 * constants.LINEAR_SLOP
TOUCHING_DISTANCE = _TARGET + _TOLERANCE
"""Cores that are closer than this touch [m]."""
_MAX_ADVANCES, _MAX_PUSH_BACKS, _MAX_ROOT_STEPS = 20, 8, 50
"""Iterations of Box2D's three nested loops: of axes, of deepest points, of root finding."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sweep:
    """The motion of parts within a step, linear in time (`b2Sweep`).

    Attributes:
        place: centres of mass at the beginning [m].
        turn: angles at the beginning [rad].
        end_place: centres of mass at the end [m].
        end_turn: angles at the end [rad].
    """

    place: Vec
    turn: jax.Array
    end_place: Vec
    end_turn: jax.Array

    def at(self, time: jax.Array | float) -> Pose:
        """The pose at a time from 0 to 1."""
        place, turn = self.interpolated(time)
        return pose(place, turn)

    def interpolated(self, time: jax.Array | float) -> tuple[Vec, jax.Array]:
        """Place and angle at a time from 0 to 1."""
        place = self.place * (1.0 - time) + self.end_place * time
        return place, (1.0 - time) * self.turn + time * self.end_turn


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _SeparationAxis:
    """The axis on which the separation of an edge and a part is measured (`b2SeparationFunction`).

    Attributes:
        of_part: whether the axis is fixed to the part; else it is fixed to the world.
        normal: from the edge to the part, in the world; if `of_part` from the part to the edge, in
            the part's frame.
        anchor: a point of the edge, in the world; if `of_part` a point of the part, in its frame
            [m].
    """

    of_part: jax.Array
    normal: Vec
    anchor: Vec

    def deepest(self, part: Pose, edges: Edges) -> Vec:
        """The deepest point: the part's, in its frame; if `of_part` the edge's, in the world."""
        depths = dot(part.world_vector(CORNERS), self.normal)
        chosen = pick(first_of(depths <= depths.min(0)), CORNERS)
        turned = part.world_vector(self.normal)
        of_edge = where(dot(edges.end - edges.start, turned) < 0, edges.end, edges.start)
        return where(self.of_part, of_edge, chosen)

    def distance(self, part: Pose, point: Vec) -> jax.Array:
        """Separation of a point, found by `deepest`, along the axis [m]."""
        of_part = dot(point - part.world_point(self.anchor), part.world_vector(self.normal))
        return jnp.where(
            self.of_part, of_part, dot(part.world_point(point) - self.anchor, self.normal)
        )


def _closest(part: Pose, edges: Edges) -> tuple[jax.Array, _SeparationAxis]:
    """Distance of the cores [m], 0 where they overlap, and the axis of the closest features."""
    along = edges.end - edges.start
    square = dot(along, along)
    upright = tangent(along) * (1.0 / jnp.sqrt(square))

    # Corners of the part, each with the edge's nearest point.
    corners = part.world_point(CORNERS)
    shares = dot(corners - edges.start, along) / square
    aways = corners - (edges.start + along * jnp.clip(shares, 0.0, 1.0))
    squares = dot(aways, aways)
    of_corner = squares.min(0)
    corner = pick(once(first_of(squares <= of_corner)), corners)
    share = dot(corner - edges.start, along) / square
    inside = (share > 0) & (share < 1)
    on_edge = edges.start + along * jnp.clip(share, 0.0, 1.0)
    away = corner - on_edge
    facing = where(dot(upright, away) < 0, -upright, upright)
    from_end = away * (1.0 / jnp.sqrt(jnp.maximum(of_corner, 1e-30)))
    normal = where(inside, facing, from_end)
    anchor = where(inside, edges.start, on_edge)

    # Ends of the edge whose nearest point of the part lies inside one of its sides.
    side = NEXT_CORNERS - CORNERS
    depths, reached = [], []
    for end in (part.local_point(edges.start), part.local_point(edges.end)):
        share = dot(end - CORNERS, side) / dot(side, side)
        depth = dot(end - CORNERS, NORMALS)
        depths.append(depth)
        over = (share > 0) & (share < 1) & (depth > 0)
        reached.append(jnp.where(over, depth * depth, jnp.inf))
    of_side = jnp.minimum(reached[0], reached[1])
    least = of_side.min(0)
    of_part = least < of_corner
    place = once(first_of(of_side <= least))
    normal = where(of_part, pick(place, NORMALS), normal)
    anchor = where(of_part, pick(place, (CORNERS + NEXT_CORNERS) * 0.5), anchor)

    heights = cross(along, corners - edges.start)
    apart = (jnp.minimum(depths[0], depths[1]) > 0).any(0)
    apart = apart | (heights > 0).all(0) | (heights < 0).all(0)
    distance = jnp.sqrt(jnp.minimum(of_corner, least))
    return jnp.where(apart, distance, 0.0), _SeparationAxis(of_part, normal, anchor)


def _edges_time_of_impact(sweep: Sweep, edges: Edges) -> jax.Array:
    """`time_of_impact` with edges alone."""

    def advance(carry: tuple) -> tuple:
        count, time, met, active = carry
        part = sweep.at(time)
        distance, axis = _closest(part, edges)
        touching = distance < TOUCHING_DISTANCE
        met = met | (active & touching & (distance > 0))
        active = active & ~touching
        time, lands, goes_on = _advance_along(sweep, edges, axis, time, active)
        return count + 1, time, met | lands, goes_on

    def goes(carry: tuple) -> jax.Array:
        count, _, _, active = carry
        return active.any() & (count < _MAX_ADVANCES)

    zero = jnp.zeros_like(edges.start.x)
    never = jnp.zeros_like(zero, bool)
    _, time, met, _ = jax.lax.while_loop(goes, advance, (0, zero, never, edges.exist))
    return jnp.where(met, time, 1.0)


def _advance_along(
    sweep: Sweep, edges: Edges, axis: _SeparationAxis, time: jax.Array, active: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Advances time until the separation along one axis reaches the target.

    Returns:
        The new time; whether it is the time of impact; whether the next axis must be searched.
    """

    def push_back(carry: tuple) -> tuple:
        count, time, late, pushing, lands, goes_on = carry
        at_late = sweep.at(late)
        point = axis.deepest(at_late, edges)
        deep = axis.distance(at_late, point)
        apart = deep > TOUCHING_DISTANCE
        advanced = pushing & ~apart & (deep > _TARGET - _TOLERANCE)
        time = jnp.where(advanced, late, time)
        goes_on = goes_on | advanced
        pushing = pushing & ~apart & ~advanced
        now = axis.distance(sweep.at(time), point)
        failed, there = now < _TARGET - _TOLERANCE, now <= TOUCHING_DISTANCE
        lands = lands | (pushing & there & ~failed)
        pushing = pushing & ~there & ~failed
        late = jnp.where(pushing, _root(sweep, axis, point, time, late, now, deep, pushing), late)
        return count + 1, time, late, pushing, lands, goes_on

    def goes(carry: tuple) -> jax.Array:
        count, _, _, pushing, _, _ = carry
        return pushing.any() & (count < _MAX_PUSH_BACKS)

    never = jnp.zeros_like(active)
    start = (0, time, jnp.ones_like(time), active, never, never)
    _, time, _, pushing, lands, goes_on = jax.lax.while_loop(goes, push_back, start)
    return time, lands, goes_on | pushing


def _root(
    sweep: Sweep,
    axis: _SeparationAxis,
    point: Vec,
    early: jax.Array,
    late: jax.Array,
    far: jax.Array,
    deep: jax.Array,
    active: jax.Array,
) -> jax.Array:
    """The time at which a point has the target separation, by bisection and secants in turn."""

    def step(carry: tuple) -> tuple:
        count, early, late, far, deep, time, active = carry
        secant = early + (_TARGET - far) * (late - early) / (deep - far)
        guess = jnp.where(count % 2 == 1, secant, 0.5 * (early + late))
        time = jnp.where(active, guess, time)
        distance = axis.distance(sweep.at(guess), point)
        active = active & ~(jnp.abs(distance - _TARGET) < _TOLERANCE)
        is_early = active & (distance > _TARGET)
        is_late = active & ~(distance > _TARGET)
        early, far = jnp.where(is_early, guess, early), jnp.where(is_early, distance, far)
        late, deep = jnp.where(is_late, guess, late), jnp.where(is_late, distance, deep)
        return count + 1, early, late, far, deep, time, active

    def goes(carry: tuple) -> jax.Array:
        return carry[-1].any() & (carry[0] < _MAX_ROOT_STEPS)

    start = (0, early, late, far, deep, late, active)
    return jax.lax.while_loop(goes, step, start)[5]


def time_of_impact(sweep: Sweep, near: NearbyGround) -> jax.Array:
    """The times at which parts first touch edges and boxes, by conservative advancement.

    Args:
        sweep: of the parts.
        near: edges and boxes [slots, parts, B].

    Returns:
        Shares of the sweep's time, [slots or 2 slots, parts, B]; 1 where a part does not touch, or
        overlaps to begin with.
    """
    if near.boxes is None:
        return _edges_time_of_impact(sweep, near.edges)
    # From outside, a box is as far away as the nearest of its sides.
    kinds = [near.edges, *near.boxes.sides()]
    every: Edges = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *kinds)
    of_edges, *of_sides = jnp.split(_edges_time_of_impact(sweep, every), len(kinds))
    return jnp.concatenate([of_edges, functools.reduce(jnp.minimum, of_sides)])


def may_touch(end: Pose, near: NearbyGround) -> jax.Array:
    """Whether parts end a step so near the ground that they may have touched it, bool [B]."""
    may = _may_touch_edges(end, near.edges)
    if near.boxes is None:
        return may
    apart = near.boxes.separation(end.world_point(CORNERS))
    return may | ((apart < TOUCHING_DISTANCE) & near.boxes.exist).any((0, 1))


def _may_touch_edges(end: Pose, edges: Edges) -> jax.Array:
    along = edges.end - edges.start
    upright = tangent(along) * (-1.0 / jnp.sqrt(dot(along, along)))
    above = dot(upright, end.world_point(CORNERS) - edges.start).min(0)
    start, stop = end.local_point(edges.start), end.local_point(edges.end)
    beside = jnp.minimum(dot(start - CORNERS, NORMALS), dot(stop - CORNERS, NORMALS)).max(0)
    apart = jnp.maximum(above, beside)
    return ((apart < TOUCHING_DISTANCE) & edges.exist).any((0, 1))
