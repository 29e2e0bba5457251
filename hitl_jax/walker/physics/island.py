"""The solver of a step: velocity and position iterations over joints and contacts.

The walker's five bodies are one island (`b2Island::Solve`): the joints are solved first, then the
contacts. Arrays have the batch as their last axis, [5, B] for bodies and so on.
"""

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp

from hitl_jax.walker import constants
from hitl_jax.walker.batching.masked_subset import apply_to_subset
from hitl_jax.walker.geometry import Speeds, Vec, where
from hitl_jax.walker.gpu import leg_threads
from hitl_jax.walker.physics import contact_solver, joints
from hitl_jax.walker.physics.contact_solver import ContactConstraints, Pair
from hitl_jax.walker.physics.contacts import Contacts
from hitl_jax.walker.physics.joints import JointConstraints, JointImpulses
from hitl_jax.walker.physics.manifolds import Manifold
from hitl_jax.xla import gpu

Tree = TypeVar("Tree")

_ITERATIONS_FOR_ALL = 2
"""Position iterations that all walkers of a batch make together; most need no more."""
_FEW_SLOTS = 2
"""Slots that most shins need: they stand on so many edges at once, at most."""
_SHINS, _LEGS = (2, 4), (1, 2, 3, 4)
"""Rows of the bodies."""
_LEAST_SEPARATION = -3 * constants.LINEAR_SLOP
"""Position iterations end when no contact is deeper [m]."""
_BAUMGARTE = 0.2
"""Share of a depth that a position iteration corrects (`b2_baumgarte`)."""


def with_hull(bodies: Vec, legs: Vec) -> Vec:
    """Rows of all bodies [5, B]: the hull's of `bodies` [5, B], then those of `legs` [4, B]."""
    return Vec(jnp.concatenate([bodies.x[:1], legs.x]), jnp.concatenate([bodies.y[:1], legs.y]))


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
    normal: Pair
    friction: Pair


def solve_velocities(
    speeds: Speeds,
    impulses: JointImpulses,
    joint: JointConstraints,
    constraints: ContactConstraints,
    contacts: Contacts,
) -> tuple[Speeds, JointImpulses, tuple[Pair, Pair]]:
    """Velocities after gravity and all velocity iterations, and impulses of joints and contacts.

    Most walkers touch the ground with their shins alone, and each shin on two edges at most. On a
    CPU all walkers are first solved with those contacts alone; walkers with other contacts are then
    solved again with all.

    Args:
        speeds: velocities of the bodies before the step [5, B].
        impulses: of the joints in the step before [4, B].
        joint: constraints of the joints [4, B].
        constraints: of the contacts [4, 4, B].
        contacts: with the impulses to start from [4, 4, B].

    Returns:
        Velocities [5, B], the joints' impulses, and the contacts' normal and friction impulses.
    """
    gravity = constants.SECONDS * constants.GRAVITY
    velocity = Vec(speeds.velocity.x, speeds.velocity.y + gravity)
    normal, friction = contact_solver.starting_impulses(constraints, contacts)
    legs = contact_solver.warm_start(
        Speeds(velocity[1:], speeds.spin[1:]), constraints, normal, friction
    )
    rows = _rows(with_hull(velocity, legs.velocity), jnp.concatenate([speeds.spin[:1], legs.spin]))
    start_impulses = joints.starting_impulses(joint, impulses)
    rows = joints.warm_start(rows, joint, start_impulses)
    if gpu.on_gpu():
        return leg_threads.velocities(
            _stacked(rows), start_impulses, (normal, friction), joint, constraints
        )
    rows_of_joints = [
        jax.tree.map(lambda leaf, i=i: leaf[i], start_impulses)
        for i in range(len(constants.JOINTS))
    ]
    start = _Motion(rows, rows_of_joints, normal, friction)

    touching = contacts.touching
    many = touching[_FEW_SLOTS:].any((0, 1)) | touching[:, ::2].any((0, 1))
    motion = apply_to_subset(
        many,
        lambda _, context: _iterate_velocities(*context, _LEGS),
        _iterate_few_contacts(start, joint, constraints),
        (start, joint, constraints),
    )
    return _stacked(motion.rows), _stacked(motion.joint), (motion.normal, motion.friction)


def _iterate_few_contacts(
    start: _Motion, joint: JointConstraints, constraints: ContactConstraints
) -> _Motion:
    """All velocity iterations, with the first `_FEW_SLOTS` contacts of the shins alone."""
    normal, friction = contact_solver.of_shins((start.normal, start.friction), _FEW_SLOTS)
    few = _Motion(start.rows, start.joint, normal, friction)
    after = _iterate_velocities(
        few,
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


def _iterate_velocities(
    start: _Motion,
    joint: JointConstraints,
    constraints: ContactConstraints,
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
    """The velocities of each body [B], from rows."""
    return [Speeds(Vec(velocity.x[i], velocity.y[i]), spin[i]) for i in range(spin.shape[0])]


def _stacked(trees: Sequence[Tree]) -> Tree:
    result: Tree = jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
    return result


def solve_positions(
    place: Vec, angle: jax.Array, side: jax.Array, manifold: Manifold
) -> tuple[Vec, jax.Array]:
    """Places and angles after the position iterations; most walkers need one or two.

    Args:
        place: centres of mass of the bodies [5, B] [m].
        angle: of the bodies [5, B] [rad].
        side: of the joints' limits [4, B], see `JointConstraints.side`.
        manifold: of the contacts [4, 4, B].

    Returns:
        Places and angles after the iterations.
    """
    if gpu.on_gpu():
        return leg_threads.positions(place, angle, side, manifold, _BAUMGARTE, _LEAST_SEPARATION)
    carry, context = (place, angle, jnp.ones(angle.shape[1:], bool)), (side, manifold)
    carry = jax.lax.fori_loop(
        0, _ITERATIONS_FOR_ALL, lambda _, carry: _position_iteration(carry, *context), carry
    )
    place, angle, _ = apply_to_subset(carry[2], _later_positions, carry, context)
    return place, angle


def _later_positions(carry: tuple, context: tuple) -> tuple:
    """The other position iterations, while a walker needs one and more are allowed."""

    def goes(counted: tuple) -> jax.Array:
        return counted[1][2].any() & (counted[0] < constants.POSITION_ITERATIONS)

    def one(counted: tuple) -> tuple:
        return counted[0] + 1, _position_iteration(counted[1], *context)

    result: tuple = jax.lax.while_loop(goes, one, (_ITERATIONS_FOR_ALL, carry))[1]
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
