"""When parts that would enter the ground within a step meet it.

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
from hitl_jax.walker.physics.boxes import Near
from hitl_jax.walker.physics.manifolds import CORNERS, NEXT_CORNERS, NORMALS, Edges, first_of, pick

_TARGET = constants.LINEAR_SLOP
"""An impact leaves this distance between the cores [m]: the skins' thickness less three slops."""
_TOLERANCE = 0.25 * constants.LINEAR_SLOP
NEAR = _TARGET + _TOLERANCE
"""Closer than this, cores have met [m]."""
_ADVANCES, _PUSHES, _ROOTS = 20, 8, 50


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sweep:
    """The motion of parts within a step, linear in time.

    Attributes:
        place: where they begin [m].
        turn: their angles there [rad].
        end_place: where they end.
        end_turn: their angles there.
    """

    place: Vec
    turn: jax.Array
    end_place: Vec
    end_turn: jax.Array

    def at(self, time: jax.Array | float) -> Pose:
        """The pose at a time from 0 to 1."""
        place, turn = self.part_way(time)
        return pose(place, turn)

    def part_way(self, time: jax.Array | float) -> tuple[Vec, jax.Array]:
        """Place and angle at a time from 0 to 1."""
        place = self.place * (1.0 - time) + self.end_place * time
        return place, (1.0 - time) * self.turn + time * self.end_turn


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Axis:
    """Along which the distance of an edge and a part is followed.

    Attributes:
        of_part: whether it turns with the part.
        normal: from the edge to the part in the world, or else from the part to the edge, in it.
        anchor: a point of the edge in the world, or else one of the part, in it.
    """

    of_part: jax.Array
    normal: Vec
    anchor: Vec

    def deepest(self, part: Pose, edges: Edges) -> Vec:
        """The point that is deepest: of the part, in it; or else of the edge, in the world."""
        depths = dot(part.turned(CORNERS), self.normal)
        chosen = pick(first_of(depths <= depths.min(0)), CORNERS)
        turned = part.turned(self.normal)
        of_edge = where(dot(edges.end - edges.start, turned) < 0, edges.end, edges.start)
        return where(self.of_part, of_edge, chosen)

    def distance(self, part: Pose, point: Vec) -> jax.Array:
        """Of a point, found by `deepest`, from the other side [m]."""
        of_part = dot(point - part.put(self.anchor), part.turned(self.normal))
        return jnp.where(self.of_part, of_part, dot(part.put(point) - self.anchor, self.normal))


def _closest(part: Pose, edges: Edges) -> tuple[jax.Array, _Axis]:
    """Distance of the cores [m], 0 where they overlap, and the axis between what is closest."""
    along = edges.end - edges.start
    square = dot(along, along)
    upright = tangent(along) * (1.0 / jnp.sqrt(square))

    # Corners of the part, each with the edge's nearest point.
    corners = part.put(CORNERS)
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

    # Ends of the edge that are nearest to the middle of a side.
    side = NEXT_CORNERS - CORNERS
    depths, reached = [], []
    for end in (part.took(edges.start), part.took(edges.end)):
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
    return jnp.where(apart, distance, 0.0), _Axis(of_part, normal, anchor)


def _time_of_impact(sweep: Sweep, edges: Edges) -> jax.Array:
    def advance(carry: tuple) -> tuple:
        count, time, met, active = carry
        part = sweep.at(time)
        distance, axis = _closest(part, edges)
        touching = distance < NEAR
        met = met | (active & touching & (distance > 0))
        active = active & ~touching
        time, lands, goes_on = _follow(sweep, edges, axis, time, active)
        return count + 1, time, met | lands, goes_on

    def goes(carry: tuple) -> jax.Array:
        count, _, _, active = carry
        return active.any() & (count < _ADVANCES)

    zero = jnp.zeros_like(edges.start.x)
    never = jnp.zeros_like(zero, bool)
    _, time, met, _ = jax.lax.while_loop(goes, advance, (0, zero, never, edges.exist))
    return jnp.where(met, time, 1.0)


def _follow(
    sweep: Sweep, edges: Edges, axis: _Axis, time: jax.Array, active: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Goes along one axis as far as it can.

    Returns:
        The new time; where it lands there; where another axis is to be looked for.
    """

    def push(carry: tuple) -> tuple:
        count, time, late, pushing, lands, goes_on = carry
        at_late = sweep.at(late)
        point = axis.deepest(at_late, edges)
        deep = axis.distance(at_late, point)
        apart = deep > NEAR
        advanced = pushing & ~apart & (deep > _TARGET - _TOLERANCE)
        time = jnp.where(advanced, late, time)
        goes_on = goes_on | advanced
        pushing = pushing & ~apart & ~advanced
        now = axis.distance(sweep.at(time), point)
        failed, there = now < _TARGET - _TOLERANCE, now <= NEAR
        lands = lands | (pushing & there & ~failed)
        pushing = pushing & ~there & ~failed
        late = jnp.where(pushing, _root(sweep, axis, point, time, late, now, deep, pushing), late)
        return count + 1, time, late, pushing, lands, goes_on

    def goes(carry: tuple) -> jax.Array:
        count, _, _, pushing, _, _ = carry
        return pushing.any() & (count < _PUSHES)

    never = jnp.zeros_like(active)
    start = (0, time, jnp.ones_like(time), active, never, never)
    _, time, _, pushing, lands, goes_on = jax.lax.while_loop(goes, push, start)
    return time, lands, goes_on | pushing


def _root(
    sweep: Sweep,
    axis: _Axis,
    point: Vec,
    early: jax.Array,
    late: jax.Array,
    far: jax.Array,
    deep: jax.Array,
    active: jax.Array,
) -> jax.Array:
    """The time at which a point is at the target's distance; halving and secants by turns."""

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
        return carry[-1].any() & (carry[0] < _ROOTS)

    start = (0, early, late, far, deep, late, active)
    return jax.lax.while_loop(goes, step, start)[5]


def time_of_impact(sweep: Sweep, near: Near) -> jax.Array:
    """When parts meet what is near them, by conservative advancement.

    Args:
        sweep: of the parts.
        near: edges and boxes.

    Returns:
        Times from 0 to 1; 1 where they do not meet, or overlap to begin with.
    """
    if near.boxes is None:
        return _time_of_impact(sweep, near.edges)
    # From outside, a box is as far away as the nearest of its sides.
    kinds = [near.edges, *near.boxes.sides()]
    every: Edges = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *kinds)
    of_edges, *of_sides = jnp.split(_time_of_impact(sweep, every), len(kinds))
    return jnp.concatenate([of_edges, functools.reduce(jnp.minimum, of_sides)])


def may_meet(end: Pose, near: Near) -> jax.Array:
    """Whether parts are at the end of a step so near the ground that they may have met it, [B]."""
    may = _may_meet_edges(end, near.edges)
    if near.boxes is None:
        return may
    apart = near.boxes.gap(end.put(CORNERS))
    return may | ((apart < NEAR) & near.boxes.exist).any((0, 1))


def _may_meet_edges(end: Pose, edges: Edges) -> jax.Array:
    along = edges.end - edges.start
    upright = tangent(along) * (-1.0 / jnp.sqrt(dot(along, along)))
    above = dot(upright, end.put(CORNERS) - edges.start).min(0)
    start, stop = end.took(edges.start), end.took(edges.end)
    beside = jnp.minimum(dot(start - CORNERS, NORMALS), dot(stop - CORNERS, NORMALS)).max(0)
    apart = jnp.maximum(above, beside)
    return ((apart < NEAR) & edges.exist).any((0, 1))
