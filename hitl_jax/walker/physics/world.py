"""One step of the walker's world, as Box2D 2.3 makes it: `b2World::Step`.

Contacts of the hull with the ground are not solved, since the first one ends the episode; those of
the legs are. Arrays have the batch as their last axis, [5, B] for bodies and so on, so that each
operation runs along it.
"""

import dataclasses

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants
from hitl_jax.walker.batching.masked_subset import apply_to_subset
from hitl_jax.walker.geometry import Pose, Speeds, Vec, dot, pose, tangent
from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.walker.physics import contact_solver, ground, impacts, joints
from hitl_jax.walker.physics.boxes import NearbyGround
from hitl_jax.walker.physics.contacts import Contacts, ground_contact_after, match_impulses
from hitl_jax.walker.physics.island import solve_positions, solve_velocities, with_hull
from hitl_jax.walker.physics.joints import JointImpulses
from hitl_jax.walker.physics.manifolds import CORNERS, Manifold, polygon, touching_first
from hitl_jax.walker.physics.time_of_impact import TOUCHING_DISTANCE, Sweep, may_touch
from hitl_jax.walker.terrain import Terrain

_PARTS = (4,)
"""Axis of the legs' parts, for `as_kernel`."""
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
    manifold, contacts, ground_contact, rows = as_kernel(_collide, _PARTS)(
        legs, near, world.contacts, world.ground_contact
    )
    fallen = world.fallen | _hull_touches(bodies, terrain, 2 * constants.POLYGON_RADIUS)

    joint = joints.prepare(bodies, world.angle, speed, torque)
    constraints = contact_solver.ContactConstraints(contact_solver.LEG_INVERSE_MASSES, *rows)
    speeds, impulses, contact_impulses = solve_velocities(
        Speeds(world.velocity, world.spin), world.impulses, joint, constraints, contacts
    )
    contacts = dataclasses.replace(
        contacts, normal=contact_impulses[0], friction=contact_impulses[1]
    )
    speeds, place, angle = impacts.integrate_positions(
        speeds, world.place, world.angle, constants.SECONDS
    )
    place, angle = solve_positions(place, angle, joint.side, manifold)

    moved = impacts.LegMotion(
        sweep=Sweep(world.place[1:], world.angle[1:], place[1:], angle[1:]),
        done=jnp.zeros_like(angle[1:]),
        speeds=Speeds(speeds.velocity[1:], speeds.spin[1:]),
        contacts=contacts,
        ground_contact=ground_contact,
    )
    ended = pose(place, angle)
    near = ground.near_parts(terrain, legs_left(legs_of(ended)))
    may_impact = may_touch(legs_of(ended), near)
    moved = apply_to_subset(may_impact, impacts.solve_impacts, moved, near, parts=_PARTS)
    fallen |= _hull_touches(ended, terrain, TOUCHING_DISTANCE)
    return World(
        place=with_hull(place, moved.sweep.end_place),
        angle=jnp.concatenate([angle[:1], moved.sweep.end_turn]),
        velocity=with_hull(speeds.velocity, moved.speeds.velocity),
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
    touches = ((apart <= distance) & edges.exist).any(0)
    if near.boxes is None:
        return touches
    others = near.boxes.corners
    beside = dot(normals[:, None], others - corners[:, None]).min(1).max(0)
    apart = jnp.maximum(near.boxes.separation(corners), beside)
    return touches | ((apart <= distance) & near.boxes.exist).any(0)
