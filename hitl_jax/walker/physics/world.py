"""One step of the world, as Box2D 2.3 makes it: `b2World::Step`.

What the ground does to the hull is not solved: the touch ends the episode. Everything else that the
walker meets is. Arrays have the batch as their last axis, [5, B] for bodies and so on, so that each
operation runs along it.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants, gpu
from hitl_jax.walker.batching.masked_subset import rarely
from hitl_jax.walker.geometry import Pose, Speeds, Vec, dot, pose, tangent, where
from hitl_jax.walker.gpu.four_threads import solver as four_threads
from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.walker.physics import contact_solver, ground, impacts, joints, manifolds
from hitl_jax.walker.physics.boxes import Near
from hitl_jax.walker.physics.joints import Impulses
from hitl_jax.walker.physics.manifolds import Contacts
from hitl_jax.walker.physics.time_of_impact import NEAR, Sweep, may_meet
from hitl_jax.walker.terrain import Terrain

Tree = TypeVar("Tree")

_ROUNDS_FOR_ALL = 2
"""Position rounds that all walkers make together; most need no more."""
_FEW = 2
"""Edges on which most shins stand at once, at most."""
_SHINS, _LEGS = (2, 4), (1, 2, 3, 4)
_PARTS = (len(_LEGS),)
"""The axis of the legs' parts, for `as_kernel`."""
_SOUND = -3 * constants.LINEAR_SLOP
_FIRMNESS = 0.2


_HULL_CORNERS, _HULL_NORMALS = manifolds.polygon(
    (constants.HULL_CORNERS - constants.HULL_CENTRE)[None]
)
"""[corners, 1 for the edges, 1 for the batch]."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class World:
    """Everything that a step begins with.

    Attributes:
        place: centres of mass of hull, thigh, shin, thigh, shin [5, B] [m].
        angle: of these [5, B] [rad].
        velocity: of the centres of mass [5, B] [m/s].
        spin: [5, B] [rad/s].
        impulses: of the hinges in the last step [4, B].
        contacts: of thigh, shin, thigh, shin with the ground [4, 4, B].
        feet: whether each of these four stands, as gymnasium hears of it, bool [4, B].
        fallen: whether the hull has touched the ground, bool [B].
    """

    place: Vec
    angle: jax.Array
    velocity: Vec
    spin: jax.Array
    impulses: Impulses
    contacts: Contacts
    feet: jax.Array
    fallen: jax.Array


def step(world: World, speed: jax.Array, torque: jax.Array, terrain: Terrain) -> World:
    """One step of `constants.SECONDS`.

    Args:
        world: before it.
        speed: that each motor is to reach [4, B] [rad/s].
        torque: the most it may give [4, B] [N m].
        terrain: leaves [TERRAIN_LENGTH, B].

    Returns:
        The world after it.
    """
    bodies = pose(world.place, world.angle)
    legs = legs_of(bodies)
    near = ground.near_parts(terrain, legs_left(legs))
    touched = as_kernel(_touched, _PARTS) if gpu.uses_four_threads() else _touched
    manifold, contacts, feet, seen = touched(legs, near, world.contacts, world.feet)
    fallen = world.fallen | _hull_meets(bodies, terrain, 2 * constants.SKIN)

    hinge = joints.prepare(bodies, world.angle, speed, torque)
    grip = contact_solver.Grips(contact_solver.WEIGHT, *seen)
    speeds, impulses, pressed = _velocities(world, hinge, grip, contacts)
    contacts = dataclasses.replace(contacts, normal=pressed[0], along=pressed[1])
    speeds, place, angle = impacts.glide(speeds, world.place, world.angle, constants.SECONDS)
    place, angle = _settle(place, angle, hinge.side, manifold)

    moved = impacts.Moved(
        sweep=Sweep(world.place[1:], world.angle[1:], place[1:], angle[1:]),
        done=jnp.zeros_like(angle[1:]),
        speeds=Speeds(speeds.velocity[1:], speeds.spin[1:]),
        contacts=contacts,
        feet=feet,
    )
    ended = pose(place, angle)
    near = ground.near_parts(terrain, legs_left(legs_of(ended)))
    meets = may_meet(legs_of(ended), near)
    moved = rarely(meets, impacts.land, moved, near, parts=_PARTS)
    fallen |= _hull_meets(ended, terrain, NEAR)
    return World(
        place=_after_head(place, moved.sweep.end_place),
        angle=jnp.concatenate([angle[:1], moved.sweep.end_turn]),
        velocity=_after_head(speeds.velocity, moved.speeds.velocity),
        spin=jnp.concatenate([speeds.spin[:1], moved.speeds.spin]),
        impulses=impulses,
        contacts=moved.contacts,
        feet=moved.feet,
        fallen=fallen,
    )


def _touched(
    legs: Pose, near: Near, before: Contacts, feet: jax.Array
) -> tuple[manifolds.Manifold, Contacts, jax.Array, tuple]:
    """Where the parts touch, what is remembered of it, who stands, and `Grips` but their weight."""
    manifold = manifolds.forward(near.touch(legs))
    contacts = manifolds.remember(before, manifold)
    grip = contact_solver.prepare(manifold, legs)
    seen = grip.points, grip.matrix, grip.inverse
    return manifold, contacts, manifolds.feet_after(feet, before, contacts), seen


def _after_head(bodies: Vec, legs: Vec) -> Vec:
    return Vec(jnp.concatenate([bodies.x[:1], legs.x]), jnp.concatenate([bodies.y[:1], legs.y]))


def legs_of(bodies: Pose) -> Pose:
    """The poses of the legs' parts [4, B] of those of all bodies [5, B]."""
    return Pose(bodies.place[1:], bodies.cos[1:], bodies.sin[1:])


def legs_left(legs: Pose) -> jax.Array:
    """Where the parts of the legs begin, skin included [4, B] [m]."""
    return legs.put(manifolds.CORNERS).x.min((0, 1)) - 2 * constants.SKIN


def _hull_meets(bodies: Pose, terrain: Terrain, distance: float) -> jax.Array:
    """Whether the core of the hull is so near the ground [m], bool [B]."""
    hull = Pose(bodies.place[0], bodies.cos[0], bodies.sin[0])
    corners, normals = hull.put(_HULL_CORNERS), hull.turned(_HULL_NORMALS)
    near = ground.near_hull(terrain, corners.x.min((0, 1)) - 2 * constants.SKIN)
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
    apart = jnp.maximum(near.boxes.gap(corners), beside)
    return meets | ((apart <= distance) & near.boxes.exist).any(0)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Motion:
    """Velocities and impulses within a step.

    Attributes:
        rows: velocities of the five bodies.
        hinge: impulses of the four hinges.
        normal: of the contacts, of their two points [slots, parts, B].
        along: likewise, of friction.
    """

    rows: list[Speeds]
    hinge: list[Impulses]
    normal: contact_solver.Pair
    along: contact_solver.Pair


def _velocities(
    world: World, hinge: joints.Hinges, grip: contact_solver.Grips, contacts: Contacts
) -> tuple[Speeds, Impulses, tuple[contact_solver.Pair, contact_solver.Pair]]:
    """Velocities after gravity and all rounds, and the impulses of hinges and contacts.

    On a CPU most walkers, which touch the ground with their shins alone, each on two edges at most,
    are worked on without the other contacts; for the others the rounds are made again.
    """
    gravity = constants.SECONDS * constants.GRAVITY
    velocity = Vec(world.velocity.x, world.velocity.y + gravity)
    normal, along = contact_solver.begin(grip, contacts)
    legs = contact_solver.warm(Speeds(velocity[1:], world.spin[1:]), grip, normal, along)
    rows = _rows(_after_head(velocity, legs.velocity), jnp.concatenate([world.spin[:1], legs.spin]))
    begun = joints.begin(hinge, world.impulses)
    rows = joints.warm(rows, hinge, begun)
    if gpu.uses_four_threads():
        return four_threads.velocities(_stacked(rows), begun, (normal, along), hinge, grip)
    impulses = [
        jax.tree.map(lambda leaf, i=i: leaf[i], begun) for i in range(len(constants.HINGES))
    ]
    start = _Motion(rows, impulses, normal, along)

    touching = contacts.touching
    many = touching[_FEW:].any((0, 1)) | touching[:, ::2].any((0, 1))
    if gpu.on_gpu():
        motion = as_kernel(_either_rounds)(many, start, hinge, grip)
    else:
        motion = rarely(
            many,
            lambda _, context: _rounds(*context, _LEGS),
            _few_rounds(start, hinge, grip),
            (start, hinge, grip),
        )
    return _stacked(motion.rows), _stacked(motion.hinge), (motion.normal, motion.along)


def _few_rounds(start: _Motion, hinge: joints.Hinges, grip: contact_solver.Grips) -> _Motion:
    """All velocity rounds, with the contacts that most walkers have and no others."""
    normal, along = contact_solver.of_shins((start.normal, start.along), _FEW)
    begun = _Motion(start.rows, start.hinge, normal, along)
    after = _rounds(begun, hinge, contact_solver.only_shins(grip, _FEW), _SHINS, unroll=True)

    def placed(all_of: jax.Array, few_of: jax.Array) -> jax.Array:
        thighs = all_of[:_FEW, ::2]
        first = jnp.stack([thighs, few_of], axis=2).reshape(_FEW, *all_of.shape[1:])
        return jnp.concatenate([first, all_of[_FEW:]])

    return _Motion(
        after.rows,
        after.hinge,
        jax.tree.map(placed, start.normal, after.normal),
        jax.tree.map(placed, start.along, after.along),
    )


def _either_rounds(
    many: jax.Array, start: _Motion, hinge: joints.Hinges, grip: contact_solver.Grips
) -> _Motion:
    """All velocity rounds; in a kernel, where `many` is asked of each walker by itself."""
    result: _Motion = jax.lax.cond(
        many.any(),
        lambda: _rounds(start, hinge, grip, _LEGS),
        lambda: _few_rounds(start, hinge, grip),
    )
    return result


def _rounds(
    start: _Motion,
    hinge: joints.Hinges,
    grip: contact_solver.Grips,
    bodies: tuple[int, ...],
    unroll: bool = False,
) -> _Motion:
    """All velocity rounds; the contacts are those of some bodies, `unroll` is of their slots."""

    def round_(_: int, motion: _Motion) -> _Motion:
        rows, impulses = joints.velocity_round(motion.rows, hinge, motion.hinge)
        legs = _stacked([rows[body] for body in bodies])
        speeds, normal, along = contact_solver.velocity_round(
            Speeds(legs.velocity, legs.spin), grip, motion.normal, motion.along, unroll
        )
        for body, row in zip(bodies, _rows(speeds.velocity, speeds.spin), strict=True):
            rows[body] = row
        return _Motion(rows, impulses, normal, along)

    return jax.lax.fori_loop(0, constants.VELOCITY_ROUNDS, round_, start)


def _rows(velocity: Vec, spin: jax.Array) -> list[Speeds]:
    return [Speeds(Vec(velocity.x[i], velocity.y[i]), spin[i]) for i in range(spin.shape[0])]


def _stacked(trees: Sequence[Tree]) -> Tree:
    result: Tree = jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
    return result


def _settle(
    place: Vec, angle: jax.Array, side: jax.Array, manifold: manifolds.Manifold
) -> tuple[Vec, jax.Array]:
    """Places and angles after the position rounds, of which most walkers need one or two."""
    if gpu.uses_four_threads():
        return four_threads.settled(place, angle, side, manifold, _FIRMNESS, _SOUND)
    carry, context = (place, angle, jnp.ones(angle.shape[1:], bool)), (side, manifold)
    if gpu.on_gpu():
        place, angle, _ = as_kernel(functools.partial(_position_rounds, 0))(carry, context)
        return place, angle
    carry = jax.lax.fori_loop(
        0, _ROUNDS_FOR_ALL, lambda _, carry: _position_round(carry, *context), carry
    )
    later = functools.partial(_position_rounds, _ROUNDS_FOR_ALL)
    place, angle, _ = rarely(carry[2], later, carry, context)
    return place, angle


def _position_rounds(made: int, carry: tuple, context: tuple) -> tuple:
    """As many rounds, after those that were made, as are needed and allowed."""

    def goes(counted: tuple) -> jax.Array:
        return counted[1][2].any() & (counted[0] < constants.POSITION_ROUNDS)

    def one(counted: tuple) -> tuple:
        return counted[0] + 1, _position_round(counted[1], *context)

    result: tuple = jax.lax.while_loop(goes, one, (made, carry))[1]
    return result


def _position_round(carry: tuple, side: jax.Array, manifold: manifolds.Manifold) -> tuple:
    """Places, angles, and who needs another round; from those before it."""
    place, angle, active = carry
    legs, turns, least = contact_solver.position_round(
        place[1:], angle[1:], manifold, contact_solver.WEIGHT, _FIRMNESS
    )
    places = [Vec(place.x[0], place.y[0])]
    places += [Vec(legs.x[i], legs.y[i]) for i in range(4)]
    places, all_turns, good = joints.position_round(places, [angle[0], *turns], side)
    place = where(active, _stacked(places), place)
    angle = jnp.where(active, jnp.stack(all_turns), angle)
    return place, angle, active & ~(good & (least >= _SOUND).all(0))
