"""Solves the four joints by sequential impulses: motor, limit and shared point of two bodies.

Arrays are [4 joints, B] where not said otherwise; bodies are rows of [5, B].

Source: E. Catto, "Iterative Dynamics with Temporal Coherence", 2005, and the behaviour of Box2D
2.3's revolute joint.
"""

import dataclasses
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.batching.compute_once import once
from hitl_jax.walker.geometry import Pose, Speeds, Vec, cross, dot, pose, vec

Tree = TypeVar("Tree")

_A, _B = np.array(constants.JOINTS, np.int32).T


def _column(values: np.ndarray) -> jax.Array:
    return jnp.asarray(values, jnp.float32)[..., None]


_MASS_A, _MASS_B = (_column(constants.INVERSE_MASS[body]) for body in (_A, _B))
_INERTIA_A, _INERTIA_B = (_column(constants.INVERSE_INERTIA[body]) for body in (_A, _B))
_ANCHOR_A, _ANCHOR_B = vec(constants.ANCHORS[:, 0], 1), vec(constants.ANCHORS[:, 1], 1)
_LOWER, _UPPER = _column(constants.LOWER), _column(constants.UPPER)
_REFERENCE = _column(constants.REFERENCE)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class JointImpulses:
    """The joints' impulses of a step, from which the next step starts (warm starting).

    Attributes:
        point: holds the two bodies together at the joint [N s].
        limit: holds the angle inside its limits; above 0 at the lower one, below 0 at the upper one
            [N m s].
        motor: of the motor [N m s].
    """

    point: Vec
    limit: jax.Array
    motor: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class JointConstraints:
    """What stays constant of the joints during a step's velocity iterations.

    Attributes:
        arm_a: from the first body's centre of mass to the joint [m].
        arm_b: from the second's.
        side: 1 at the lower limit, -1 at the upper one, 0 between them.
        point_inverse: the inverse of the 2 by 2 matrix of the point: xx, xy, yy.
        point_limit_inverse: the inverse of the 3 by 3 matrix of point and limit: xx, xy, xz, yy,
            yz, zz.
        coupling: of point and limit in that matrix.
        speed: the motor's [rad/s].
        max_motor_impulse: the most that the motor gives in a step [N m s].
    """

    arm_a: Vec
    arm_b: Vec
    side: jax.Array
    point_inverse: tuple[jax.Array, jax.Array, jax.Array]
    point_limit_inverse: tuple[jax.Array, ...]
    coupling: Vec
    speed: jax.Array
    max_motor_impulse: jax.Array


def angles(angle: jax.Array) -> jax.Array:
    """The joints' angles [4, B] from those of the bodies [5, B] [rad]."""
    return angle[_B] - angle[_A] - _REFERENCE


def speeds(spin: jax.Array) -> jax.Array:
    """How fast the joints turn [4, B] [rad/s]."""
    return spin[_B] - spin[_A]


def prepare(body: Pose, angle: jax.Array, speed: jax.Array, torque: jax.Array) -> JointConstraints:
    """The constraints of the joints for the velocity iterations of a step.

    Args:
        body: poses of the bodies, [5, B].
        angle: of the bodies [5, B] [rad].
        speed: of the motors [4, B] [rad/s].
        torque: the most that the motors give [4, B] [N m].

    Returns:
        The constraints.
    """
    arm_a, arm_b = _rotated(body, _A, _ANCHOR_A), _rotated(body, _B, _ANCHOR_B)
    now = angles(angle)
    beyond = jnp.where(now >= _UPPER, np.float32(-1.0), 0.0)
    side = jnp.where(now <= _LOWER, 1.0, beyond)
    xx, xy, yy = _point_matrix(arm_a, arm_b)
    coupling = Vec(
        -arm_a.y * _INERTIA_A - arm_b.y * _INERTIA_B, arm_a.x * _INERTIA_A + arm_b.x * _INERTIA_B
    )
    zz = _INERTIA_A + _INERTIA_B
    return JointConstraints(
        arm_a=arm_a,
        arm_b=arm_b,
        side=side,
        point_inverse=_inverse_2(xx, xy, yy),
        point_limit_inverse=_inverse_3(xx, xy, coupling.x, yy, coupling.y, zz),
        coupling=coupling,
        speed=speed,
        max_motor_impulse=constants.SECONDS * torque,
    )


def _rotated(body: Pose, rows: np.ndarray, local: Vec) -> Vec:
    """Vectors in the frames of some bodies, in the world."""
    cos, sin = body.cos[rows], body.sin[rows]
    return Vec(cos * local.x - sin * local.y, sin * local.x + cos * local.y)


def _point_matrix(arm_a: Vec, arm_b: Vec) -> tuple[jax.Array, jax.Array, jax.Array]:
    """K of the point: its velocity per unit of impulse there: xx, xy, yy [1/kg]."""
    mass = _MASS_A + _MASS_B
    xx = mass + arm_a.y * arm_a.y * _INERTIA_A + arm_b.y * arm_b.y * _INERTIA_B
    xy = -arm_a.y * arm_a.x * _INERTIA_A - arm_b.y * arm_b.x * _INERTIA_B
    yy = mass + arm_a.x * arm_a.x * _INERTIA_A + arm_b.x * arm_b.x * _INERTIA_B
    return xx, xy, yy


def _inverse_2(
    xx: jax.Array, xy: jax.Array, yy: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    scale = 1.0 / (xx * yy - xy * xy)
    return yy * scale, -xy * scale, xx * scale


def _inverse_3(
    xx: jax.Array, xy: jax.Array, xz: jax.Array, yy: jax.Array, yz: jax.Array, zz: jax.Array
) -> tuple[jax.Array, ...]:
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = 1.0 / (xx * a + xy * b + xz * c)
    return a * scale, b * scale, c * scale, d * scale, e * scale, f * scale


def starting_impulses(constraints: JointConstraints, impulses: JointImpulses) -> JointImpulses:
    """The impulses to warm start with; a limit that the joint has left starts from 0."""
    holds = constraints.side * impulses.limit > 0
    return JointImpulses(impulses.point, jnp.where(holds, impulses.limit, 0.0), impulses.motor)


def _apply_impulse(
    index: int,
    pair: tuple[Speeds, Speeds],
    constraint: JointConstraints,
    point: Vec,
    turn: jax.Array,
) -> tuple[Speeds, Speeds]:
    """The velocities of a joint's two bodies after an impulse and an angular impulse at it."""
    first, second = constants.JOINTS[index]
    mass, inertia = constants.INVERSE_MASS, constants.INVERSE_INERTIA
    a, b = pair
    return Speeds(
        a.velocity - point * float(mass[first]),
        a.spin - float(inertia[first]) * (cross(constraint.arm_a, point) + turn),
    ), Speeds(
        b.velocity + point * float(mass[second]),
        b.spin + float(inertia[second]) * (cross(constraint.arm_b, point) + turn),
    )


def _row(tree: Tree, index: int) -> Tree:
    result: Tree = jax.tree.map(lambda leaf: leaf[index], tree)
    return result


def warm_start(
    rows: list[Speeds], constraints: JointConstraints, impulses: JointImpulses
) -> list[Speeds]:
    """The bodies' velocities after the impulses of `starting_impulses`."""
    rows = list(rows)
    for index in constants.JOINT_ORDER:
        first, second = constants.JOINTS[index]
        start = _row(impulses, index)
        rows[first], rows[second] = _apply_impulse(
            index,
            (rows[first], rows[second]),
            _row(constraints, index),
            start.point,
            start.motor + start.limit,
        )
    return rows


def velocity_iteration(
    rows: list[Speeds], constraints: JointConstraints, impulses: list[JointImpulses]
) -> tuple[list[Speeds], list[JointImpulses]]:
    """One velocity iteration over all joints, in Box2D's order.

    Args:
        rows: velocities of the five bodies.
        constraints: of the joints [4, B].
        impulses: accumulated, one for each joint, [B].

    Returns:
        Velocities and impulses after it.
    """
    rows, impulses = list(rows), list(impulses)
    for index in constants.JOINT_ORDER:
        first, second = constants.JOINTS[index]
        (rows[first], rows[second]), impulses[index] = solve_velocities(
            index, (rows[first], rows[second]), _row(constraints, index), impulses[index]
        )
    return rows, impulses


def solve_velocities(
    index: int, pair: tuple[Speeds, Speeds], constraint: JointConstraints, before: JointImpulses
) -> tuple[tuple[Speeds, Speeds], JointImpulses]:
    """One velocity iteration of one joint: the motor, then point and limit together.

    Args:
        index: which joint; those of the two legs have equal constants.
        pair: velocities of its two bodies.
        constraint: of this joint, [B].
        before: its accumulated impulses.

    Returns:
        The pair and the impulses after it.
    """
    first, second = constants.JOINTS[index]
    motor_mass = float(1.0 / (constants.INVERSE_INERTIA[first] + constants.INVERSE_INERTIA[second]))
    max_motor_impulse = constraint.max_motor_impulse
    slip = pair[1].spin - pair[0].spin - constraint.speed
    motor = once(jnp.clip(before.motor - motor_mass * slip, -max_motor_impulse, max_motor_impulse))
    zero = jnp.zeros_like(motor)
    a, b = _apply_impulse(index, pair, constraint, Vec(zero, zero), motor - before.motor)

    arm_a, arm_b = constraint.arm_a, constraint.arm_b
    x = b.velocity.x - b.spin * arm_b.y - a.velocity.x + a.spin * arm_a.y
    y = b.velocity.y + b.spin * arm_b.x - a.velocity.y - a.spin * arm_a.x
    x, y, z = once((x, y, b.spin - a.spin))
    side, limit = constraint.side, before.limit
    xx, xy, xz, yy, yz, zz = constraint.point_limit_inverse
    turn = -(xz * x + yz * y + zz * z)
    holds = (side != 0) & (side * (limit + turn) >= 0)
    turn = jnp.where(holds, turn, -limit)
    # A limit only pushes: where it would pull, its impulse becomes 0 and the point is solved alone.
    alone_x, alone_y = limit * constraint.coupling.x - x, limit * constraint.coupling.y - y
    pxx, pxy, pyy = constraint.point_inverse
    point = Vec(
        jnp.where(holds, -(xx * x + xy * y + xz * z), pxx * alone_x + pxy * alone_y),
        jnp.where(holds, -(xy * x + yy * y + yz * z), pxy * alone_x + pyy * alone_y),
    )
    point, turn = once((point, turn))
    pair = _apply_impulse(index, (a, b), constraint, point, turn)
    return pair, JointImpulses(before.point + point, limit + turn, motor)


BodyPosition = tuple[Vec, jax.Array]
"""Place of a body's centre of mass [m], and the body's angle [rad]."""


def position_iteration(
    places: list[Vec], turns: list[jax.Array], side: jax.Array
) -> tuple[list[Vec], list[jax.Array], jax.Array]:
    """One position iteration over all joints: corrects limits and points, in Box2D's order.

    Args:
        places: centres of mass of the five bodies, [B] each.
        turns: their angles [rad].
        side: of the limits, as `JointConstraints.side`.

    Returns:
        Places and angles after it, and whether all errors were within tolerance before, bool [B].
    """
    bodies = list(zip(places, turns, strict=True))
    good = jnp.ones(side.shape[1:], bool)
    for index in constants.JOINT_ORDER:
        first, second = constants.JOINTS[index]
        (bodies[first], bodies[second]), was_good = solve_positions(
            index, (bodies[first], bodies[second]), side[index], float(constants.REFERENCE[index])
        )
        good &= was_good
    bodies = once(bodies)
    return [place for place, _ in bodies], [turn for _, turn in bodies], good


def solve_positions(
    index: int,
    pair: tuple[BodyPosition, BodyPosition],
    side: jax.Array,
    reference: jax.Array | float,
) -> tuple[tuple[BodyPosition, BodyPosition], jax.Array]:
    """One position iteration of one joint: corrects its limit, then its point.

    Args:
        index: which joint; those of the two legs have equal constants.
        pair: its two bodies.
        side: of its limit, as `JointConstraints.side`.
        reference: the difference of the bodies' angles at joint angle 0 [rad].

    Returns:
        The two bodies after it, and whether its errors were within tolerance before, bool.
    """
    first, second = constants.JOINTS[index]
    inertia_a, inertia_b = (float(constants.INVERSE_INERTIA[body]) for body in (first, second))
    mass_a, mass_b = (float(constants.INVERSE_MASS[body]) for body in (first, second))
    motor_mass = 1.0 / (inertia_a + inertia_b)
    (place_a, turn_a), (place_b, turn_b) = pair
    # How far beyond the limit, the same for both limits but for the sign.
    angle = turn_b - turn_a - reference
    bound = jnp.where(
        side > 0, np.float32(constants.LOWER[index]), np.float32(constants.UPPER[index])
    )
    beyond = side * (bound - angle)
    good = (side == 0) | (beyond <= constants.ANGULAR_SLOP)
    excess = jnp.clip(beyond - constants.ANGULAR_SLOP, 0.0, constants.MAX_ANGULAR_CORRECTION)
    turn = side * motor_mass * excess
    turn_a, turn_b = once((turn_a - inertia_a * turn, turn_b + inertia_b * turn))

    arm_a = pose(place_a, turn_a).world_vector(vec(constants.ANCHORS[index, 0]))
    arm_b = pose(place_b, turn_b).world_vector(vec(constants.ANCHORS[index, 1]))
    apart = place_b + arm_b - place_a - arm_a
    arm_a, arm_b, apart = once((arm_a, arm_b, apart))
    good &= dot(apart, apart) <= constants.LINEAR_SLOP**2
    xx = mass_a + mass_b + inertia_a * arm_a.y * arm_a.y + inertia_b * arm_b.y * arm_b.y
    xy = -inertia_a * arm_a.x * arm_a.y - inertia_b * arm_b.x * arm_b.y
    yy = mass_a + mass_b + inertia_a * arm_a.x * arm_a.x + inertia_b * arm_b.x * arm_b.x
    scale = -1.0 / (xx * yy - xy * xy)
    push = once(Vec(scale * (yy * apart.x - xy * apart.y), scale * (xx * apart.y - xy * apart.x)))
    a = place_a - push * mass_a, turn_a - inertia_a * cross(arm_a, push)
    b = place_b + push * mass_b, turn_b + inertia_b * cross(arm_b, push)
    return (a, b), good
