"""Solves the contacts of the legs with the ground: friction, and points that must not sink in.

Arrays are [slots, parts, B] where not said otherwise, those of parts alone [parts, B]. The ground
does not move, so contacts of one part do not change another's velocity: the first slots of all
parts are solved at once, then the second ones, and so on.

Source: E. Catto, "Iterative Dynamics with Temporal Coherence", 2005, and the behaviour of Box2D
2.3's contact solver (friction first, then both points of a contact as a linear complementarity
problem).
"""

import dataclasses
from typing import TypeVar

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.geometry import Pose, Speeds, Vec, cross, dot, pose, tangent
from hitl_jax.walker.physics.contacts import Contacts
from hitl_jax.walker.physics.manifolds import Manifold
from hitl_jax.xla import gpu

_MAX_CONDITION_NUMBER = 1000.0

Pair = tuple[jax.Array, jax.Array]
Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class InverseMasses:
    """Inverse masses of the parts.

    Attributes:
        mass: 1 / mass [parts, 1] [1/kg].
        inertia: 1 / moment of inertia [parts, 1] [1/(kg m²)].
    """

    mass: jax.Array
    inertia: jax.Array


LEG_INVERSE_MASSES = InverseMasses(
    jnp.asarray(constants.INVERSE_MASS[1:, None], jnp.float32),
    jnp.asarray(constants.INVERSE_INERTIA[1:, None], jnp.float32),
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ConstraintPoint:
    """A contact point in the velocity iterations (`b2VelocityConstraintPoint`).

    All numbers are 0 where there is no point.

    Attributes:
        normal: from the ground to the part.
        normal_arm: cross product of arm and normal: an impulse's lever along the normal [m].
        tangent_arm: cross product of arm and tangent [m].
        normal_mass: effective mass along the normal, of this point alone [kg].
        tangent_mass: effective mass along the tangent [kg].
    """

    normal: Vec
    normal_arm: jax.Array
    tangent_arm: jax.Array
    normal_mass: jax.Array
    tangent_mass: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ContactConstraints:
    """What stays constant of the contacts during a step's velocity iterations.

    Attributes:
        inverse_masses: of the parts.
        points: two.
        matrix: K: the points' normal velocities per unit of normal impulse: xx, xy, yy [1/kg].
        inverse: of that matrix: xx, xy, yy [kg].
    """

    inverse_masses: InverseMasses
    points: tuple[ConstraintPoint, ConstraintPoint]
    matrix: tuple[jax.Array, jax.Array, jax.Array]
    inverse: tuple[jax.Array, jax.Array, jax.Array]


def prepare(manifold: Manifold, part: Pose) -> ContactConstraints:
    """The constraints of contacts for the velocity iterations of a step.

    Args:
        manifold: [slots, parts, B].
        part: poses of the parts [parts, B].

    Returns:
        The constraints.
    """
    mass, inertia = LEG_INVERSE_MASSES.mass, LEG_INVERSE_MASSES.inertia
    arms = []
    for (normal, point, separation), valid in zip(
        manifold.in_world(part), manifold.valid, strict=True
    ):
        # The impulse acts in the middle between the two skins.
        to_middle = 0.5 * (separation + 2 * constants.POLYGON_RADIUS)
        arm = point - normal * to_middle * _skin_direction(manifold) - part.place
        arms.append((normal, cross(arm, normal), cross(arm, tangent(normal)), valid))
    (_, turn_1, _, valid_1), (_, turn_2, _, valid_2) = arms
    xx, yy = (mass + inertia * turn * turn for turn in (turn_1, turn_2))
    xy = mass + inertia * turn_1 * turn_2
    # Where the matrix of two points is nearly singular, the first is solved alone.
    both = valid_1 & valid_2
    singular = both & ~(xx * xx < _MAX_CONDITION_NUMBER * (xx * yy - xy * xy))
    valid_2 &= ~singular
    both &= ~singular
    points = []
    for (normal, turn, slide, _), valid in zip(arms, (valid_1, valid_2), strict=True):
        there = valid.astype(jnp.float32)
        points.append(
            ConstraintPoint(
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
    return ContactConstraints(LEG_INVERSE_MASSES, (points[0], points[1]), (xx, xy, yy), inverse)


def _skin_direction(manifold: Manifold) -> jax.Array:
    """1 where the point is the part's and -1 where it is the ground's: the way to the middle."""
    return jnp.where(manifold.on_edge, 1.0, jnp.float32(-1.0))


def _apply_impulse(
    speeds: Speeds,
    inverse_masses: InverseMasses,
    point: ConstraintPoint,
    normal: jax.Array,
    friction: jax.Array,
) -> Speeds:
    """The velocities of parts after impulses at a point, along its normal and tangent [N s]."""
    side = tangent(point.normal)
    velocity = speeds.velocity + (point.normal * normal + side * friction) * inverse_masses.mass
    spin = speeds.spin + inverse_masses.inertia * (
        point.normal_arm * normal + point.tangent_arm * friction
    )
    return Speeds(velocity, spin)


def of_shins(tree: Tree, slots: int) -> Tree:
    """The shins' rows of the first slots.

    Args:
        tree: of arrays [slots, parts, B].
        slots: how many slots to take.

    Returns:
        Arrays [slots, 2, B].
    """
    result: Tree = jax.tree.map(lambda leaf: leaf[:slots, 1::2], tree)
    return result


def only_shins(constraints: ContactConstraints, slots: int) -> ContactConstraints:
    """The constraints of the shins' first slots; see `of_shins`."""
    inverse_masses = InverseMasses(
        constraints.inverse_masses.mass[1::2], constraints.inverse_masses.inertia[1::2]
    )
    rows = of_shins((constraints.points, constraints.matrix, constraints.inverse), slots)
    return ContactConstraints(inverse_masses, *rows)


def starting_impulses(constraints: ContactConstraints, contacts: Contacts) -> tuple[Pair, Pair]:
    """The normal and friction impulses to warm start with; 0 where there is no point [N s]."""
    there = [point.normal_mass > 0 for point in constraints.points]
    normal, friction = (
        tuple(jnp.where(is_there, value, 0.0) for is_there, value in zip(there, pair, strict=True))
        for pair in (contacts.normal, contacts.friction)
    )
    return normal, friction  # type: ignore[return-value]


def warm_start(
    speeds: Speeds, constraints: ContactConstraints, normals: Pair, frictions: Pair
) -> Speeds:
    """The velocities of the parts after the impulses of `starting_impulses`."""
    still = jax.tree.map(jnp.zeros_like, speeds)
    for point, normal, friction in zip(constraints.points, normals, frictions, strict=True):
        pushed = _apply_impulse(still, constraints.inverse_masses, point, normal, friction)
        speeds = jax.tree.map(lambda speed, of_slots: speed + of_slots.sum(0), speeds, pushed)
    return speeds


def velocity_iteration(
    speeds: Speeds,
    constraints: ContactConstraints,
    normal: Pair,
    friction: Pair,
    unroll: bool = False,
) -> tuple[Speeds, Pair, Pair]:
    """One velocity iteration over all contacts, slot after slot.

    Args:
        speeds: of the parts.
        constraints: of the contacts.
        normal: accumulated impulses along the normals [N s].
        friction: accumulated impulses along the tangents [N s].
        unroll: static; whether the loop over slots is unrolled: a larger program, and on a CPU a
            faster one.

    Returns:
        Velocities, normal impulses and friction impulses after it.
    """

    def one(speeds: Speeds, slot: tuple) -> tuple[Speeds, tuple[Pair, Pair]]:
        rows, *before = slot
        here = ContactConstraints(constraints.inverse_masses, *rows)
        if gpu.on_gpu():  # A thread skips a slot in which it has no contact.
            there = (here.points[0].normal_mass > 0) | (here.points[1].normal_mass > 0)
            after = jax.lax.cond(
                there.any(), _solve_slot_velocities, lambda _, *same: same, here, speeds, *before
            )
        else:
            after = _solve_slot_velocities(here, speeds, *before)
        return after[0], after[1:]

    slots = (constraints.points, constraints.matrix, constraints.inverse), normal, friction
    speeds, impulses = jax.lax.scan(one, speeds, slots, unroll=unroll)
    return speeds, *impulses


def _solve_slot_velocities(
    constraints: ContactConstraints, speeds: Speeds, normal: Pair, friction: Pair
) -> tuple[Speeds, Pair, Pair]:
    """One velocity iteration of one slot: friction, then both normals together."""
    frictions = []
    zero = jnp.zeros_like(speeds.spin)
    for point, pressing, before in zip(constraints.points, normal, friction, strict=True):
        speed = dot(tangent(point.normal), speeds.velocity) + speeds.spin * point.tangent_arm
        bound = constants.FRICTION * pressing
        after = once(jnp.clip(before - point.tangent_mass * speed, -bound, bound))
        speeds = _apply_impulse(speeds, constraints.inverse_masses, point, zero, after - before)
        frictions.append(after)
    one, two = constraints.points
    xx, xy, yy = constraints.matrix
    velocity_1 = dot(one.normal, speeds.velocity) + speeds.spin * one.normal_arm
    velocity_2 = dot(two.normal, speeds.velocity) + speeds.spin * two.normal_arm
    velocity_1, velocity_2 = once(
        (
            velocity_1 - (xx * normal[0] + xy * normal[1]),
            velocity_2 - (xy * normal[0] + yy * normal[1]),
        )
    )
    after_1, after_2 = once(_solve_normal_impulses(constraints, velocity_1, velocity_2, normal))
    speeds = _apply_impulse(speeds, constraints.inverse_masses, one, after_1 - normal[0], zero)
    speeds = _apply_impulse(speeds, constraints.inverse_masses, two, after_2 - normal[1], zero)
    return speeds, (after_1, after_2), (frictions[0], frictions[1])


def _solve_normal_impulses(
    constraints: ContactConstraints, velocity_1: jax.Array, velocity_2: jax.Array, normal: Pair
) -> Pair:
    """The normal impulses x of two points [N s], by trying the four cases in Box2D's order.

    They solve the linear complementarity problem: x ≥ 0, K x + velocity ≥ 0, and at each point one
    of the two is 0. Where no case fits, the impulses stay as they are.
    """
    _, xy, _ = constraints.matrix
    ixx, ixy, iyy = constraints.inverse
    both_1, both_2 = -(ixx * velocity_1 + ixy * velocity_2), -(ixy * velocity_1 + iyy * velocity_2)
    is_both = (both_1 >= 0) & (both_2 >= 0)
    one, two = constraints.points
    only_1, only_2 = -one.normal_mass * velocity_1, -two.normal_mass * velocity_2
    is_first = (only_1 >= 0) & (xy * only_1 + velocity_2 >= 0)
    is_second = (only_2 >= 0) & (xy * only_2 + velocity_1 >= 0)
    is_none = (velocity_1 >= 0) & (velocity_2 >= 0)
    after_1 = jnp.where(is_second | is_none, 0.0, normal[0])
    after_1 = jnp.where(is_both, both_1, jnp.where(is_first, only_1, after_1))
    after_2 = jnp.where(is_second, only_2, jnp.where(is_none, 0.0, normal[1]))
    after_2 = jnp.where(is_both, both_2, jnp.where(is_first, 0.0, after_2))
    return after_1, after_2


def position_iteration(
    place: Vec, turn: jax.Array, manifold: Manifold, inverse_masses: InverseMasses, baumgarte: float
) -> tuple[Vec, jax.Array, jax.Array]:
    """One position iteration over all contacts: pushes parts out of the ground, slot after slot.

    Args:
        place: centres of mass of the parts [parts, B] [m].
        turn: their angles [parts, B] [rad].
        manifold: [slots, parts, B].
        inverse_masses: of the parts.
        baumgarte: the share of the depth that is corrected at once.

    Returns:
        Places and angles after it, and the least separation that was met, at most 0 [parts, B]
        [m].
    """

    def one(carry: tuple, here: Manifold) -> tuple[tuple, None]:
        after = jax.lax.cond(
            here.touching.any(),
            _solve_slot_positions,
            lambda carry, *_: carry,
            carry,
            here,
            inverse_masses,
            baumgarte,
        )
        return after, None

    carry, _ = jax.lax.scan(one, (place, turn, jnp.zeros_like(turn)), manifold)
    return carry


def _solve_slot_positions(
    carry: tuple[Vec, jax.Array, jax.Array],
    manifold: Manifold,
    inverse_masses: InverseMasses,
    baumgarte: float,
) -> tuple[Vec, jax.Array, jax.Array]:
    """One position iteration of one slot: its two points, one after the other."""
    place, turn, least = carry
    for which in range(2):
        normal, point, separation = manifold.in_world(pose(place, turn))[which]
        separation = jnp.where(manifold.valid[which], separation, 0.0)
        least = jnp.minimum(least, separation)
        depth = jnp.clip(
            baumgarte * (separation + constants.LINEAR_SLOP), -constants.MAX_LINEAR_CORRECTION, 0.0
        )
        lever = cross(point - place, normal)
        push = once(-depth / (inverse_masses.mass + inverse_masses.inertia * lever * lever))
        place = place + normal * (push * inverse_masses.mass)
        turn = turn + inverse_masses.inertia * lever * push
        place, turn = once((place, turn))
    return place, turn, least
