"""Constants of the walker's physics, derived from `hitl_jax.walker.bipedal`, and Box2D's own.

Five bodies: the hull, then the four parts of the legs in gymnasium's order (thigh and shin of one
leg, thigh and shin of the other). Four joints in gymnasium's order (hip and knee of one leg, of the
other). `[5]` and `[4]` below are these.
"""

import math
from typing import NamedTuple

import numpy as np

from hitl_jax.walker import bipedal

# Box2D 2.3, b2Settings.h
LINEAR_SLOP = 0.005
ANGULAR_SLOP = 2.0 / 180.0 * math.pi
MAX_LINEAR_CORRECTION = 0.2
MAX_ANGULAR_CORRECTION = 8.0 / 180.0 * math.pi
MAX_TRANSLATION = 2.0
MAX_ROTATION = 0.5 * math.pi
POLYGON_RADIUS = 2 * LINEAR_SLOP
"""Thickness of the skin around every polygon and edge [m] (`b2_polygonRadius`)."""

GRAVITY = -10.0
"""b2World's default [m/s²]."""

SECONDS = bipedal.SECONDS
VELOCITY_ITERATIONS, POSITION_ITERATIONS = bipedal.VELOCITY_ITERATIONS, bipedal.POSITION_ITERATIONS


class Mass(NamedTuple):
    """Mass properties of a body, from its polygon and density by Gauss's area formulas.

    Attributes:
        mass: [kg].
        inertia: moment of inertia about the centre of mass [kg m²].
        centre: centre of mass, in the shape's frame [m].
    """

    mass: float
    inertia: float
    centre: tuple[float, float]


def mass_of(vertices: np.ndarray, density: float) -> Mass:
    """The mass properties of a polygon.

    Args:
        vertices: counter-clockwise [corners, 2] [m].
        density: [kg/m²].

    Returns:
        The mass properties.
    """
    following = np.roll(vertices, -1, axis=0)
    doubled = vertices[:, 0] * following[:, 1] - vertices[:, 1] * following[:, 0]
    area = doubled.sum() / 2
    centre = (doubled[:, None] * (vertices + following)).sum(0) / (6 * area)
    squares = (vertices * vertices + vertices * following + following * following).sum(1)
    mass = density * area
    inertia = density * (doubled * squares).sum() / 12 - mass * (centre**2).sum()
    return Mass(mass, inertia, (float(centre[0]), float(centre[1])))


def _rounded(numbers: object) -> np.ndarray:
    """Numbers rounded to float32, as Box2D stores them."""
    return np.array(numbers, np.float32).astype(np.float64)


def _box(width: float, height: float) -> np.ndarray:
    """Corners of a box about its centre, in the order of `b2PolygonShape::SetAsBox`."""
    x, y = width / 2, height / 2
    return _rounded([(-x, -y), (x, -y), (x, y), (-x, y)])


HULL_CORNERS = _rounded([(x / bipedal.SCALE, y / bipedal.SCALE) for x, y in bipedal.HULL_POLY])
_THIGH, _SHIN = (_box(width, bipedal.LEG_H) for width in (bipedal.LEG_W, bipedal.SHIN_W))
LEG_CORNERS = np.stack([_THIGH, _SHIN, _THIGH, _SHIN])
"""Corners of the legs' parts [4, corners, 2] [m]; side i is from corner i to the next."""

_HULL_MASS = mass_of(HULL_CORNERS, bipedal.HULL_DENSITY)
_LEG_MASSES = [mass_of(corners, bipedal.LEG_DENSITY) for corners in LEG_CORNERS]
HULL_CENTRE = np.array(_HULL_MASS.centre)
"""The hull's centre of mass in the frame of its shape [m]; those of the legs' parts are 0."""

INVERSE_MASS = np.array([1 / part.mass for part in (_HULL_MASS, *_LEG_MASSES)])
"""[5] [1/kg]."""
INVERSE_INERTIA = np.array([1 / part.inertia for part in (_HULL_MASS, *_LEG_MASSES)])
"""[5] [1/(kg m²)]."""

FRICTION = math.sqrt(float(_rounded(bipedal.LEG_FRICTION)) * bipedal.GROUND_FRICTION)
"""Friction coefficient of a leg on the ground: `b2MixFriction` of the two."""

JOINTS = ((0, 1), (1, 2), (0, 3), (3, 4))
"""The two bodies of each joint."""
JOINT_ORDER = (3, 2, 0, 1)
"""The order in which Box2D solves the joints: it follows them from body to body and begins with the
body that was made last."""

_HIP = np.array([0.0, bipedal.LEG_DOWN]) - HULL_CENTRE
_BOTTOM, _TOP = np.array([0.0, -bipedal.LEG_H / 2]), np.array([0.0, bipedal.LEG_H / 2])
ANCHORS = np.array([(_HIP, _TOP), (_BOTTOM, _TOP), (_HIP, _TOP), (_BOTTOM, _TOP)])
"""The joint in the frames of its two bodies, from their centres of mass [4, 2 bodies, 2] [m]."""

LOWER, UPPER = (
    np.array(limits * 2) for limits in zip(bipedal.HIP_LIMITS, bipedal.KNEE_LIMITS, strict=True)
)
"""Greatest angles of the joints [4] [rad]; `LOWER` has the least."""
START_TILTS = np.repeat(bipedal.SIDES, 2) * bipedal.LEG_TILT
"""Angles of the legs' parts when they are made [4] [rad]."""
_START_ANGLES = np.array([0.0, *START_TILTS])
REFERENCE = np.array([_START_ANGLES[b] - _START_ANGLES[a] for a, b in JOINTS])
"""Difference of the two bodies' angles at each joint's angle 0: pybox2d takes the difference when
the joint is made [4] [rad]."""
SPEEDS = np.array([bipedal.SPEED_HIP, bipedal.SPEED_KNEE] * 2, np.float64)
"""Target speeds of the motors [4] [rad/s]."""
TORQUE = float(bipedal.MOTORS_TORQUE)
"""The most torque a motor gives [N m]."""

TERRAIN_STEP = bipedal.TERRAIN_STEP
TERRAIN_LENGTH = bipedal.TERRAIN_LENGTH
CORNER_X = (np.arange(TERRAIN_LENGTH) * TERRAIN_STEP).astype(np.float32)
"""x of the ground's corners [TERRAIN_LENGTH] [m]."""
NUM_EDGES = TERRAIN_LENGTH - 1
GOAL = bipedal.GOAL
"""The episode ends where the hull's x is larger [m]."""
