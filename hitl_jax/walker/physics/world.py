"""One step of the walker's world, as Box2D 2.3 makes it: `b2World::Step`.

Contacts of the hull with the ground are not solved, since the first one ends the episode; those of
the legs are. Arrays have the batch as their last axis, [5, B] for bodies and so on, so that each
operation runs along it.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants, gpu
from hitl_jax.walker.batching.masked_subset import apply_to_subset
from hitl_jax.walker.geometry import Pose, Speeds, Vec, dot, pose, tangent, where
from hitl_jax.walker.gpu.four_threads import solver as four_threads
from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.walker.physics import contact_solver, ground, impacts, joints
from hitl_jax.walker.physics.boxes import NearbyGround
from hitl_jax.walker.physics.contacts import Contacts, ground_contact_after, match_impulses
from hitl_jax.walker.physics.joints import JointImpulses
from hitl_jax.walker.physics.manifolds import CORNERS, Manifold, polygon, touching_first
from hitl_jax.walker.physics.time_of_impact import TOUCHING_DISTANCE, Sweep, may_touch
from hitl_jax.walker.terrain import Terrain

Tree = TypeVar("Tree")

_ITERATIONS_FOR_ALL = 2
"""Position iterations that all walkers of a batch make together; most need no more."""
_FEW_SLOTS = 2
"""Slots that most shins need: they stand on so many edges at once, at most."""
_SHINS, _LEGS = (2, 4), (1, 2, 3, 4)
_PARTS = (len(_LEGS),)
"""The axis of the legs' parts, for `as_kernel`."""
_LEAST_SEPARATION = -3 * constants.LINEAR_SLOP
"""Position iterations end when no contact is deeper [m]."""
_BAUMGARTE = 0.2
"""Share of a depth that a position iteration corrects (`b2_baumgarte`)."""


_HULL_CORNERS, _HULL_NORMALS = polygon((constants.HULL_CORNERS - constants.HULL_CENTRE)[None])
"""[corners, 1 for the edges, 1 for the batch]."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class World:
    """The state of walkers at the beginning of a step.

    Attributes:
        place: centres of mass of hull, thigh, shin, thigh, shin [5, B] [m].
        angle: of these [5, B] [rad].
        velocity: of the centres of mass [5, B] [m/s].
        spin: [5, B] [rad/s].
        impulses: of the joints in the step before [4, B].
        contacts: of thigh, shin, thigh, shin with the ground [4, 4, B].
        ground_contact: gymnasium's flag of each of these four parts, bool [4, B].
        fallen: whether the hull has touched the ground, bool [B].
    """

    place: Vec
    angle: jax.Array
    velocity: Vec
    spin: jax.Array
    impulses: JointImpulses
    contacts: Contacts
    ground_contact: jax.Array
    fallen: jax.Array


def step(world: World, speed: jax.Array, torque: jax.Array, terrain: Terrain) -> World:
    """One step of `constants.SECONDS`.

    Args:
        world: the state before the step.
        speed: target speed of each motor [4, B] [rad/s].
        torque: the most that each motor may give [4, B] [N m].
        terrain: leaves [TERRAIN_LENGTH, B].

    Returns:
        The state after the step.
    """
    bodies = pose(world.place, world.angle)
    legs = legs_of(bodies)
    near = ground.near_parts(terrain, legs_left(legs))
    collide = as_kernel(_collide, _PARTS) if gpu.uses_four_threads() else _collide
    manifold, contacts, ground_contact, rows = collide(
        legs, near, world.contacts, world.ground_contact
    )
    fallen = world.fallen | _hull_touches(bodies, terrain, 2 * constants.POLYGON_RADIUS)

    joint = joints.prepare(bodies, world.angle, speed, torque)
    constraints = contact_solver.ContactConstraints(contact_solver.LEG_INVERSE_MASSES, *rows)
    speeds, impulses, contact_impulses = _solve_velocities(world, joint, constraints, contacts)
    contacts = dataclasses.replace(
        contacts, normal=contact_impulses[0], friction=contact_impulses[1]
    )
    speeds, place, angle = impacts.integrate_positions(
        speeds, world.place, world.angle, constants.SECONDS
    )
    place, angle = _solve_positions(place, angle, joint.side, manifold)

    moved = impacts.LegMotion(
        sweep=Sweep(world.place[1:], world.angle[1:], place[1:], angle[1:]),
        done=jnp.zeros_like(angle[1:]),
        speeds=Speeds(speeds.velocity[1:], speeds.spin[1:]),
        contacts=contacts,
        ground_contact=ground_contact,
    )
    ended = pose(place, angle)
    near = ground.near_parts(terrain, legs_left(legs_of(ended)))
    meets = may_touch(legs_of(ended), near)
    moved = apply_to_subset(meets, impacts.solve_impacts, moved, near, parts=_PARTS)
    fallen |= _hull_touches(ended, terrain, TOUCHING_DISTANCE)
    return World(
        place=_with_hull(place, moved.sweep.end_place),
        angle=jnp.concatenate([angle[:1], moved.sweep.end_turn]),
        velocity=_with_hull(speeds.velocity, moved.speeds.velocity),
        spin=jnp.concatenate([speeds.spin[:1], moved.speeds.spin]),
        impulses=impulses,
        contacts=moved.contacts,
        ground_contact=moved.ground_contact,
        fallen=fallen,
    )


def _collide(
    legs: Pose, near: NearbyGround, before: Contacts, ground_contact: jax.Array
) -> tuple[Manifold, Contacts, jax.Array, tuple]:
    """Finds the contacts of the legs' parts.

    Returns:
        Manifolds; contacts with their impulses; ground contact; all of `ContactConstraints` but the
        inverse masses.
    """
    manifold = touching_first(near.manifolds(legs))
    contacts = match_impulses(before, manifold)
    constraints = contact_solver.prepare(manifold, legs)
    rows = constraints.points, constraints.matrix, constraints.inverse
    return (
        manifold,
        contacts,
        ground_contact_after(ground_contact, before, contacts),
        rows,
    )


def _with_hull(bodies: Vec, legs: Vec) -> Vec:
    """Rows of all bodies [5, B]: the hull's of `bodies` [5, B], then those of `legs` [4, B]."""
    return Vec(jnp.concatenate([bodies.x[:1], legs.x]), jnp.concatenate([bodies.y[:1], legs.y]))


def legs_of(bodies: Pose) -> Pose:
    """The poses of the legs' parts [4, B] from those of all bodies [5, B]."""
    return Pose(bodies.place[1:], bodies.cos[1:], bodies.sin[1:])


def legs_left(legs: Pose) -> jax.Array:
    """The left ends of the legs' parts, skin included [4, B] [m]."""
    return legs.world_point(CORNERS).x.min((0, 1)) - 2 * constants.POLYGON_RADIUS


def _hull_touches(bodies: Pose, terrain: Terrain, distance: float) -> jax.Array:
    """Whether the hull's core is at most a distance [m] from the ground, bool [B]."""
    hull = Pose(bodies.place[0], bodies.cos[0], bodies.sin[0])
    corners, normals = hull.world_point(_HULL_CORNERS), hull.world_vector(_HULL_NORMALS)
    near = ground.near_hull(terrain, corners.x.min((0, 1)) - 2 * constants.POLYGON_RADIUS)
    edges = near.edges
    along = edges.end - edges.start
    up = tangent(along) * (-1.0 / jnp.sqrt(dot(along, along)))
    above = dot(up, corners - edges.start).min(0)
    beside = jnp.minimum(dot(normals, edges.start - corners), dot(normals, edges.end - corners))
    apart = jnp.maximum(above, beside.max(0))
    meets = ((apart <= distance) & edges.exist).any(0)
    if near.boxes is None:
        return meets
    others = near.boxes.corners
    beside = dot(normals[:, None], others - corners[:, None]).min(1).max(0)
    apart = jnp.maximum(near.boxes.separation(corners), beside)
    return meets | ((apart <= distance) & near.boxes.exist).any(0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Motion:
    """Velocities and impulses within a step.

    Attributes:
        rows: velocities of the five bodies.
        joint: impulses of the four joints.
        normal: normal impulses of the contacts' two points [slots, parts, B].
        friction: friction impulses of the contacts' two points [slots, parts, B].
    """

    rows: list[Speeds]
    joint: list[JointImpulses]
    normal: contact_solver.Pair
    friction: contact_solver.Pair


def _solve_velocities(
    world: World,
    joint: joints.JointConstraints,
    constraints: contact_solver.ContactConstraints,
    contacts: Contacts,
) -> tuple[Speeds, JointImpulses, tuple[contact_solver.Pair, contact_solver.Pair]]:
    """Velocities after gravity and all velocity iterations, and impulses of joints and contacts.

    Most walkers touch the ground with their shins alone, and each shin on two edges at most. On a
    CPU all walkers are first solved with those contacts alone; walkers with other contacts are then
    solved again with all.
    """
    gravity = constants.SECONDS * constants.GRAVITY
    velocity = Vec(world.velocity.x, world.velocity.y + gravity)
    normal, friction = contact_solver.starting_impulses(constraints, contacts)
    legs = contact_solver.warm_start(
        Speeds(velocity[1:], world.spin[1:]), constraints, normal, friction
    )
    rows = _rows(_with_hull(velocity, legs.velocity), jnp.concatenate([world.spin[:1], legs.spin]))
    start_impulses = joints.starting_impulses(joint, world.impulses)
    rows = joints.warm_start(rows, joint, start_impulses)
    if gpu.uses_four_threads():
        return four_threads.velocities(
            _stacked(rows), start_impulses, (normal, friction), joint, constraints
        )
    impulses = [
        jax.tree.map(lambda leaf, i=i: leaf[i], start_impulses)
        for i in range(len(constants.JOINTS))
    ]
    start = _Motion(rows, impulses, normal, friction)

    touching = contacts.touching
    many = touching[_FEW_SLOTS:].any((0, 1)) | touching[:, ::2].any((0, 1))
    if gpu.on_gpu():
        motion = as_kernel(_iterate_by_need)(many, start, joint, constraints)
    else:
        motion = apply_to_subset(
            many,
            lambda _, context: _iterate_velocities(*context, _LEGS),
            _iterate_few_contacts(start, joint, constraints),
            (start, joint, constraints),
        )
    return _stacked(motion.rows), _stacked(motion.joint), (motion.normal, motion.friction)


def _iterate_few_contacts(
    start: _Motion, joint: joints.JointConstraints, constraints: contact_solver.ContactConstraints
) -> _Motion:
    """All velocity iterations, with the first `_FEW_SLOTS` contacts of the shins alone."""
    normal, friction = contact_solver.of_shins((start.normal, start.friction), _FEW_SLOTS)
    start_impulses = _Motion(start.rows, start.joint, normal, friction)
    after = _iterate_velocities(
        start_impulses,
        joint,
        contact_solver.only_shins(constraints, _FEW_SLOTS),
        _SHINS,
        unroll=True,
    )

    def placed(all_of: jax.Array, few_of: jax.Array) -> jax.Array:
        thighs = all_of[:_FEW_SLOTS, ::2]
        first = jnp.stack([thighs, few_of], axis=2).reshape(_FEW_SLOTS, *all_of.shape[1:])
        return jnp.concatenate([first, all_of[_FEW_SLOTS:]])

    return _Motion(
        after.rows,
        after.joint,
        jax.tree.map(placed, start.normal, after.normal),
        jax.tree.map(placed, start.friction, after.friction),
    )


def _iterate_by_need(
    many: jax.Array,
    start: _Motion,
    joint: joints.JointConstraints,
    constraints: contact_solver.ContactConstraints,
) -> _Motion:
    """All velocity iterations, for a kernel: each thread takes all contacts only if `many`."""
    result: _Motion = jax.lax.cond(
        many.any(),
        lambda: _iterate_velocities(start, joint, constraints, _LEGS),
        lambda: _iterate_few_contacts(start, joint, constraints),
    )
    return result


def _iterate_velocities(
    start: _Motion,
    joint: joints.JointConstraints,
    constraints: contact_solver.ContactConstraints,
    bodies: tuple[int, ...],
    unroll: bool = False,
) -> _Motion:
    """All velocity iterations, with the contacts of some bodies; `unroll` is for their slots."""

    def iteration(_: int, motion: _Motion) -> _Motion:
        rows, impulses = joints.velocity_iteration(motion.rows, joint, motion.joint)
        legs = _stacked([rows[body] for body in bodies])
        speeds, normal, friction = contact_solver.velocity_iteration(
            Speeds(legs.velocity, legs.spin), constraints, motion.normal, motion.friction, unroll
        )
        for body, row in zip(bodies, _rows(speeds.velocity, speeds.spin), strict=True):
            rows[body] = row
        return _Motion(rows, impulses, normal, friction)

    return jax.lax.fori_loop(0, constants.VELOCITY_ITERATIONS, iteration, start)


def _rows(velocity: Vec, spin: jax.Array) -> list[Speeds]:
    return [Speeds(Vec(velocity.x[i], velocity.y[i]), spin[i]) for i in range(spin.shape[0])]


def _stacked(trees: Sequence[Tree]) -> Tree:
    result: Tree = jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
    return result


def _solve_positions(
    place: Vec, angle: jax.Array, side: jax.Array, manifold: Manifold
) -> tuple[Vec, jax.Array]:
    """Places and angles after the position iterations; most walkers need one or two."""
    if gpu.uses_four_threads():
        return four_threads.positions(place, angle, side, manifold, _BAUMGARTE, _LEAST_SEPARATION)
    carry, context = (place, angle, jnp.ones(angle.shape[1:], bool)), (side, manifold)
    if gpu.on_gpu():
        place, angle, _ = as_kernel(functools.partial(_iterate_positions, 0))(carry, context)
        return place, angle
    carry = jax.lax.fori_loop(
        0, _ITERATIONS_FOR_ALL, lambda _, carry: _position_iteration(carry, *context), carry
    )
    later = functools.partial(_iterate_positions, _ITERATIONS_FOR_ALL)
    place, angle, _ = apply_to_subset(carry[2], later, carry, context)
    return place, angle


def _iterate_positions(made: int, carry: tuple, context: tuple) -> tuple:
    """Position iterations after the first `made`, while a walker needs one and more are allowed."""

    def goes(counted: tuple) -> jax.Array:
        return counted[1][2].any() & (counted[0] < constants.POSITION_ITERATIONS)

    def one(counted: tuple) -> tuple:
        return counted[0] + 1, _position_iteration(counted[1], *context)

    result: tuple = jax.lax.while_loop(goes, one, (made, carry))[1]
    return result


def _position_iteration(carry: tuple, side: jax.Array, manifold: Manifold) -> tuple:
    """One position iteration: places, angles, and which walkers need another, bool [B]."""
    place, angle, active = carry
    legs, turns, least = contact_solver.position_iteration(
        place[1:], angle[1:], manifold, contact_solver.LEG_INVERSE_MASSES, _BAUMGARTE
    )
    places = [Vec(place.x[0], place.y[0])]
    places += [Vec(legs.x[i], legs.y[i]) for i in range(4)]
    places, all_turns, good = joints.position_iteration(places, [angle[0], *turns], side)
    place = where(active, _stacked(places), place)
    angle = jnp.where(active, jnp.stack(all_turns), angle)
    return place, angle, active & ~(good & (least >= _LEAST_SEPARATION).all(0))
