"""The four hinges: motors, limits and the point that two parts share, by sequential impulses.

Arrays are [4 hinges, B] where not said otherwise; bodies are rows of [5, B].

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

_A, _B = np.array(constants.HINGES, np.int32).T


def _column(values: np.ndarray) -> jax.Array:
    return jnp.asarray(values, jnp.float32)[..., None]


_MASS_A, _MASS_B = (_column(constants.INVERSE_MASS[body]) for body in (_A, _B))
_INERTIA_A, _INERTIA_B = (_column(constants.INVERSE_INERTIA[body]) for body in (_A, _B))
_MOTOR_MASS = 1.0 / (_INERTIA_A + _INERTIA_B)
_ANCHOR_A, _ANCHOR_B = vec(constants.ANCHORS[:, 0], 1), vec(constants.ANCHORS[:, 1], 1)
_LOWER, _UPPER = _column(constants.LOWER), _column(constants.UPPER)
_REFERENCE = _column(constants.REFERENCE)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Impulses:
    """What the hinges did in a step, with which the next begins.

    Attributes:
        point: that holds the two bodies together [N s].
        limit: of the limit; above 0 at the lower one, below at the upper one [N m s].
        motor: of the motor [N m s].
    """

    point: Vec
    limit: jax.Array
    motor: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Hinges:
    """What stays as it is during a step's velocity rounds.

    Attributes:
        arm_a: from the first body's centre of mass to the hinge [m].
        arm_b: from the second's.
        side: 1 at the lower limit, -1 at the upper one, 0 between.
        inverse: of the 2 by 2 matrix of the point: xx, xy, yy.
        full: the inverse of the 3 by 3 matrix of point and limit: xx, xy, xz, yy, yz, zz.
        coupling: of point and limit in that matrix.
        speed: the motor's [rad/s].
        strength: the most the motor gives in a step [N m s].
    """

    arm_a: Vec
    arm_b: Vec
    side: jax.Array
    inverse: tuple[jax.Array, jax.Array, jax.Array]
    full: tuple[jax.Array, ...]
    coupling: Vec
    speed: jax.Array
    strength: jax.Array


def angles(angle: jax.Array) -> jax.Array:
    """The hinges' angles [4, B] from those of the bodies [5, B] [rad]."""
    return angle[_B] - angle[_A] - _REFERENCE


def speeds(spin: jax.Array) -> jax.Array:
    """How fast the hinges turn [4, B] [rad/s]."""
    return spin[_B] - spin[_A]


def prepare(body: Pose, angle: jax.Array, speed: jax.Array, torque: jax.Array) -> Hinges:
    """The hinges at the beginning of a step.

    Args:
        body: poses of the bodies, [5, B].
        angle: of the bodies [5, B] [rad].
        speed: of the motors [rad/s].
        torque: the most the motors give [N m].

    Returns:
        The hinges.
    """
    arm_a, arm_b = _turned(body, _A, _ANCHOR_A), _turned(body, _B, _ANCHOR_B)
    now = angles(angle)
    beyond = jnp.where(now >= _UPPER, np.float32(-1.0), 0.0)
    side = jnp.where(now <= _LOWER, 1.0, beyond)
    xx, xy, yy = _point_matrix(arm_a, arm_b)
    coupling = Vec(
        -arm_a.y * _INERTIA_A - arm_b.y * _INERTIA_B, arm_a.x * _INERTIA_A + arm_b.x * _INERTIA_B
    )
    zz = _INERTIA_A + _INERTIA_B
    return Hinges(
        arm_a=arm_a,
        arm_b=arm_b,
        side=side,
        inverse=_inverse_2(xx, xy, yy),
        full=_inverse_3(xx, xy, coupling.x, yy, coupling.y, zz),
        coupling=coupling,
        speed=speed,
        strength=constants.SECONDS * torque,
    )


def _turned(body: Pose, rows: np.ndarray, local: Vec) -> Vec:
    cos, sin = body.cos[rows], body.sin[rows]
    return Vec(cos * local.x - sin * local.y, sin * local.x + cos * local.y)


def _point_matrix(arm_a: Vec, arm_b: Vec) -> tuple[jax.Array, jax.Array, jax.Array]:
    """How a point answers an impulse: xx, xy, yy."""
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


def begin(hinges: Hinges, impulses: Impulses) -> Impulses:
    """The impulses to begin with: that of a limit which no longer holds is dropped."""
    holds = hinges.side * impulses.limit > 0
    return Impulses(impulses.point, jnp.where(holds, impulses.limit, 0.0), impulses.motor)


def _push(
    index: int, pair: tuple[Speeds, Speeds], hinge: Hinges, point: Vec, turn: jax.Array
) -> tuple[Speeds, Speeds]:
    """The two bodies of a hinge after an impulse at it and a turning one."""
    first, second = constants.HINGES[index]
    mass, inertia = constants.INVERSE_MASS, constants.INVERSE_INERTIA
    a, b = pair
    return Speeds(
        a.velocity - point * float(mass[first]),
        a.spin - float(inertia[first]) * (cross(hinge.arm_a, point) + turn),
    ), Speeds(
        b.velocity + point * float(mass[second]),
        b.spin + float(inertia[second]) * (cross(hinge.arm_b, point) + turn),
    )


def _row(tree: Tree, index: int) -> Tree:
    result: Tree = jax.tree.map(lambda leaf: leaf[index], tree)
    return result


def warm(rows: list[Speeds], hinges: Hinges, impulses: Impulses) -> list[Speeds]:
    """Velocities after the impulses to begin with."""
    rows = list(rows)
    for index in constants.HINGE_ORDER:
        first, second = constants.HINGES[index]
        begun = _row(impulses, index)
        rows[first], rows[second] = _push(
            index,
            (rows[first], rows[second]),
            _row(hinges, index),
            begun.point,
            begun.motor + begun.limit,
        )
    return rows


def velocity_round(
    rows: list[Speeds], hinges: Hinges, impulses: list[Impulses]
) -> tuple[list[Speeds], list[Impulses]]:
    """One round over the hinges.

    Args:
        rows: velocities of the five bodies.
        hinges: that do not change.
        impulses: so far, one for each hinge, [B].

    Returns:
        Velocities and impulses after it.
    """
    rows, impulses = list(rows), list(impulses)
    for index in constants.HINGE_ORDER:
        first, second = constants.HINGES[index]
        (rows[first], rows[second]), impulses[index] = solve(
            index, (rows[first], rows[second]), _row(hinges, index), impulses[index]
        )
    return rows, impulses


def solve(
    index: int, pair: tuple[Speeds, Speeds], hinge: Hinges, before: Impulses
) -> tuple[tuple[Speeds, Speeds], Impulses]:
    """One hinge in a round: the motor, then point and limit together.

    Args:
        index: which hinge; the legs are alike.
        pair: velocities of its two bodies.
        hinge: its own row of the hinges.
        before: its impulses so far.

    Returns:
        The pair and the impulses after it.
    """
    first, second = constants.HINGES[index]
    motor_mass = float(1.0 / (constants.INVERSE_INERTIA[first] + constants.INVERSE_INERTIA[second]))
    strength = hinge.strength
    slip = pair[1].spin - pair[0].spin - hinge.speed
    motor = once(jnp.clip(before.motor - motor_mass * slip, -strength, strength))
    zero = jnp.zeros_like(motor)
    a, b = _push(index, pair, hinge, Vec(zero, zero), motor - before.motor)

    arm_a, arm_b = hinge.arm_a, hinge.arm_b
    x = b.velocity.x - b.spin * arm_b.y - a.velocity.x + a.spin * arm_a.y
    y = b.velocity.y + b.spin * arm_b.x - a.velocity.y - a.spin * arm_a.x
    x, y, z = once((x, y, b.spin - a.spin))
    side, limit = hinge.side, before.limit
    xx, xy, xz, yy, yz, zz = hinge.full
    turn = -(xz * x + yz * y + zz * z)
    holds = (side != 0) & (side * (limit + turn) >= 0)
    turn = jnp.where(holds, turn, -limit)
    # Where the limit would pull it lets go, and the point is solved without it.
    alone_x, alone_y = limit * hinge.coupling.x - x, limit * hinge.coupling.y - y
    pxx, pxy, pyy = hinge.inverse
    point = Vec(
        jnp.where(holds, -(xx * x + xy * y + xz * z), pxx * alone_x + pxy * alone_y),
        jnp.where(holds, -(xy * x + yy * y + yz * z), pxy * alone_x + pyy * alone_y),
    )
    point, turn = once((point, turn))
    pair = _push(index, (a, b), hinge, point, turn)
    return pair, Impulses(before.point + point, limit + turn, motor)


Placed = tuple[Vec, jax.Array]
"""Where a body's centre of mass is [m], and its angle [rad]."""


def position_round(
    places: list[Vec], turns: list[jax.Array], side: jax.Array
) -> tuple[list[Vec], list[jax.Array], jax.Array]:
    """One round of putting the bodies of each hinge together again.

    Args:
        places: centres of mass of the five bodies, [B] each.
        turns: their angles [rad].
        side: of the limits, as `Hinges.side`.

    Returns:
        Places and turns after it, and whether all was well before, bool [B].
    """
    bodies = list(zip(places, turns, strict=True))
    good = jnp.ones(side.shape[1:], bool)
    for index in constants.HINGE_ORDER:
        first, second = constants.HINGES[index]
        (bodies[first], bodies[second]), was_good = join(
            index, (bodies[first], bodies[second]), side[index], float(constants.REFERENCE[index])
        )
        good &= was_good
    bodies = once(bodies)
    return [place for place, _ in bodies], [turn for _, turn in bodies], good


def join(
    index: int, pair: tuple[Placed, Placed], side: jax.Array, reference: jax.Array | float
) -> tuple[tuple[Placed, Placed], jax.Array]:
    """Puts the two bodies of a hinge together again.

    Args:
        index: which hinge; the legs are alike.
        pair: its two bodies.
        side: of its limit, as `Hinges.side`.
        reference: what counts as its angle 0 [rad].

    Returns:
        The two bodies after it, and whether all was well before, bool.
    """
    first, second = constants.HINGES[index]
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

    arm_a = pose(place_a, turn_a).turned(vec(constants.ANCHORS[index, 0]))
    arm_b = pose(place_b, turn_b).turned(vec(constants.ANCHORS[index, 1]))
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
