"""Contacts of the legs with the ground: friction, and two points that do not enter it.

Arrays are [slots, parts, B] where not said otherwise, those of parts alone [parts, B]. The ground
does not move, so that parts do not feel each other here: all parts' first slots are solved at once,
then their second ones, and so on.

Source: E. Catto, "Iterative Dynamics with Temporal Coherence", 2005, and the behaviour of Box2D
2.3's contact solver (friction first, then both points of a contact as a linear complementarity
problem).
"""

import dataclasses
from typing import TypeVar

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants, gpu
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.geometry import Pose, Speeds, Vec, cross, dot, pose, tangent
from hitl_jax.walker.physics.manifolds import Contacts, Manifold

_WORST_CONDITION = 1000.0

Pair = tuple[jax.Array, jax.Array]
Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Weight:
    """How parts answer impulses.

    Attributes:
        mass: the inverse of their masses [parts, 1] [1/kg].
        inertia: the inverse of their inertias [parts, 1] [1/(kg m²)].
    """

    mass: jax.Array
    inertia: jax.Array


WEIGHT = Weight(
    jnp.asarray(constants.INVERSE_MASS[1:, None], jnp.float32),
    jnp.asarray(constants.INVERSE_INERTIA[1:, None], jnp.float32),
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Point:
    """A point of a contact, for the velocity rounds; all 0 where there is none.

    Attributes:
        normal: from the ground to the part.
        turn: of the part by an impulse along the normal: arm times normal [m].
        slide: of the part by an impulse along the tangent: arm times tangent [m].
        mass: that an impulse along the normal meets, if alone [kg].
        slide_mass: that one along the tangent meets [kg].
    """

    normal: Vec
    turn: jax.Array
    slide: jax.Array
    mass: jax.Array
    slide_mass: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Grips:
    """Contacts, as they are during a step's velocity rounds.

    Attributes:
        weight: of the parts.
        points: two.
        matrix: how the two answer each other's impulses: xx, xy, yy.
        inverse: of that matrix.
    """

    weight: "Weight"
    points: tuple[Point, Point]
    matrix: tuple[jax.Array, jax.Array, jax.Array]
    inverse: tuple[jax.Array, jax.Array, jax.Array]


def prepare(manifold: Manifold, part: Pose) -> Grips:
    """Contacts at the beginning of velocity rounds.

    Args:
        manifold: of the slots.
        part: poses of the parts.

    Returns:
        The contacts.
    """
    mass, inertia = WEIGHT.mass, WEIGHT.inertia
    seen = []
    for (normal, point, apart), valid in zip(manifold.look(part), manifold.valid, strict=True):
        # The middle between the two skins, which is what is pushed at.
        arm = point - normal * (0.5 * (apart + 2 * constants.SKIN)) * _sign(manifold) - part.place
        seen.append((normal, cross(arm, normal), cross(arm, tangent(normal)), valid))
    (_, turn_1, _, valid_1), (_, turn_2, _, valid_2) = seen
    xx, yy = (mass + inertia * turn * turn for turn in (turn_1, turn_2))
    xy = mass + inertia * turn_1 * turn_2
    # Two points that say nearly the same are solved as one.
    both = valid_1 & valid_2
    lonely = both & ~(xx * xx < _WORST_CONDITION * (xx * yy - xy * xy))
    valid_2 &= ~lonely
    both &= ~lonely
    points = []
    for (normal, turn, slide, _), valid in zip(seen, (valid_1, valid_2), strict=True):
        there = valid.astype(jnp.float32)
        points.append(
            Point(
                normal * there,
                turn * there,
                slide * there,
                there / (mass + inertia * turn * turn),
                there / (mass + inertia * slide * slide),
            )
        )
    xx, yy = (jnp.where(valid, value, 1.0) for valid, value in ((valid_1, xx), (valid_2, yy)))
    xy = jnp.where(both, xy, 0.0)
    scale = 1.0 / (xx * yy - xy * xy)
    inverse = yy * scale, -xy * scale, xx * scale
    return Grips(WEIGHT, (points[0], points[1]), (xx, xy, yy), inverse)


def _sign(manifold: Manifold) -> jax.Array:
    """Along which way the skin lies: a point of the ground is moved towards the part."""
    return jnp.where(manifold.on_edge, 1.0, jnp.float32(-1.0))


def _push(
    speeds: Speeds, weight: Weight, point: Point, normal: jax.Array, along: jax.Array
) -> Speeds:
    side = tangent(point.normal)
    velocity = speeds.velocity + (point.normal * normal + side * along) * weight.mass
    spin = speeds.spin + weight.inertia * (point.turn * normal + point.slide * along)
    return Speeds(velocity, spin)


def of_shins(tree: Tree, slots: int) -> Tree:
    """The first slots of the shins alone.

    Args:
        tree: of arrays [slots, parts, B].
        slots: how many.

    Returns:
        Arrays [slots, 2, B].
    """
    result: Tree = jax.tree.map(lambda leaf: leaf[:slots, 1::2], tree)
    return result


def only_shins(grips: Grips, slots: int) -> Grips:
    """The contacts in the first slots of the shins alone; see `of_shins`."""
    weight = Weight(grips.weight.mass[1::2], grips.weight.inertia[1::2])
    seen = of_shins((grips.points, grips.matrix, grips.inverse), slots)
    return Grips(weight, *seen)


def begin(grips: Grips, contacts: Contacts) -> tuple[Pair, Pair]:
    """The impulses to begin with, along normals and of friction: those of points there are."""
    there = [point.mass > 0 for point in grips.points]
    normal, along = (
        tuple(jnp.where(is_there, value, 0.0) for is_there, value in zip(there, pair, strict=True))
        for pair in (contacts.normal, contacts.along)
    )
    return normal, along  # type: ignore[return-value]


def warm(speeds: Speeds, grips: Grips, normals: Pair, alongs: Pair) -> Speeds:
    """Velocities after the impulses to begin with."""
    still = jax.tree.map(jnp.zeros_like, speeds)
    for point, normal, along in zip(grips.points, normals, alongs, strict=True):
        pushed = _push(still, grips.weight, point, normal, along)
        speeds = jax.tree.map(lambda speed, of_slots: speed + of_slots.sum(0), speeds, pushed)
    return speeds


def velocity_round(
    speeds: Speeds, grips: Grips, normal: Pair, along: Pair, unroll: bool = False
) -> tuple[Speeds, Pair, Pair]:
    """One round over the contacts.

    Args:
        speeds: of the parts.
        grips: the contacts.
        normal: impulses along the normals so far.
        along: impulses of friction so far.
        unroll: static; a larger program, and on a CPU a faster one.

    Returns:
        Velocities and both kinds of impulses after it.
    """

    def one(speeds: Speeds, slot: tuple) -> tuple[Speeds, tuple[Pair, Pair]]:
        seen, *before = slot
        here = Grips(grips.weight, *seen)
        if gpu.uses_four_threads():  # A thread goes by where it has no contact.
            there = (here.points[0].mass > 0) | (here.points[1].mass > 0)
            after = jax.lax.cond(there.any(), _solve, lambda _, *same: same, here, speeds, *before)
        else:
            after = _solve(here, speeds, *before)
        return after[0], after[1:]

    slots = (grips.points, grips.matrix, grips.inverse), normal, along
    speeds, impulses = jax.lax.scan(one, speeds, slots, unroll=unroll)
    return speeds, *impulses


def _solve(grip: Grips, speeds: Speeds, normal: Pair, along: Pair) -> tuple[Speeds, Pair, Pair]:
    """One slot."""
    slides = []
    zero = jnp.zeros_like(speeds.spin)
    for point, press, before in zip(grip.points, normal, along, strict=True):
        speed = dot(tangent(point.normal), speeds.velocity) + speeds.spin * point.slide
        bound = constants.FRICTION * press
        after = once(jnp.clip(before - point.slide_mass * speed, -bound, bound))
        speeds = _push(speeds, grip.weight, point, zero, after - before)
        slides.append(after)
    one, two = grip.points
    xx, xy, yy = grip.matrix
    gap_1 = dot(one.normal, speeds.velocity) + speeds.spin * one.turn
    gap_2 = dot(two.normal, speeds.velocity) + speeds.spin * two.turn
    gap_1, gap_2 = once(
        (gap_1 - (xx * normal[0] + xy * normal[1]), gap_2 - (xy * normal[0] + yy * normal[1]))
    )
    after_1, after_2 = once(_complement(grip, gap_1, gap_2, normal))
    speeds = _push(speeds, grip.weight, one, after_1 - normal[0], zero)
    speeds = _push(speeds, grip.weight, two, after_2 - normal[1], zero)
    return speeds, (after_1, after_2), (slides[0], slides[1])


def _complement(grip: Grips, gap_1: jax.Array, gap_2: jax.Array, normal: Pair) -> Pair:
    """Impulses x ≥ 0 with K x + gap ≥ 0, one of the two 0 at each point: the four cases in turn."""
    _, xy, _ = grip.matrix
    ixx, ixy, iyy = grip.inverse
    both_1, both_2 = -(ixx * gap_1 + ixy * gap_2), -(ixy * gap_1 + iyy * gap_2)
    is_both = (both_1 >= 0) & (both_2 >= 0)
    only_1, only_2 = -grip.points[0].mass * gap_1, -grip.points[1].mass * gap_2
    is_first = (only_1 >= 0) & (xy * only_1 + gap_2 >= 0)
    is_second = (only_2 >= 0) & (xy * only_2 + gap_1 >= 0)
    is_none = (gap_1 >= 0) & (gap_2 >= 0)
    after_1 = jnp.where(is_second | is_none, 0.0, normal[0])
    after_1 = jnp.where(is_both, both_1, jnp.where(is_first, only_1, after_1))
    after_2 = jnp.where(is_second, only_2, jnp.where(is_none, 0.0, normal[1]))
    after_2 = jnp.where(is_both, both_2, jnp.where(is_first, 0.0, after_2))
    return after_1, after_2


def position_round(
    place: Vec, turn: jax.Array, manifold: Manifold, weight: Weight, firmness: float
) -> tuple[Vec, jax.Array, jax.Array]:
    """One round of lifting parts out of the ground.

    Args:
        place: centres of mass of the parts.
        turn: their angles [rad].
        manifold: of the slots.
        weight: of the parts.
        firmness: the share of the depth that is taken back at once.

    Returns:
        Places and turns after it, and the least distance met, at most 0 [m], [parts, B].
    """

    def one(carry: tuple, here: Manifold) -> tuple[tuple, None]:
        after = jax.lax.cond(
            here.touching.any(), _lift, lambda carry, *_: carry, carry, here, weight, firmness
        )
        return after, None

    carry, _ = jax.lax.scan(one, (place, turn, jnp.zeros_like(turn)), manifold)
    return carry


def _lift(
    carry: tuple[Vec, jax.Array, jax.Array], manifold: Manifold, weight: Weight, firmness: float
) -> tuple[Vec, jax.Array, jax.Array]:
    """Both points of one slot, in turn."""
    place, turn, least = carry
    for which in range(2):
        normal, point, apart = manifold.look(pose(place, turn))[which]
        apart = jnp.where(manifold.valid[which], apart, 0.0)
        least = jnp.minimum(least, apart)
        depth = jnp.clip(
            firmness * (apart + constants.LINEAR_SLOP), -constants.MAX_LINEAR_CORRECTION, 0.0
        )
        lever = cross(point - place, normal)
        push = once(-depth / (weight.mass + weight.inertia * lever * lever))
        place = place + normal * (push * weight.mass)
        turn = turn + weight.inertia * lever * push
        place, turn = once((place, turn))
    return place, turn, least
