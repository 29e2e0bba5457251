"""The walker's body and its world, in numbers: gymnasium's own, and Box2D's where it names none.

Five bodies: the hull, then the four parts of the legs in gymnasium's order (thigh and shin of one
leg, thigh and shin of the other). Four hinges in gymnasium's order (hip and knee of one leg, of the
other). `[5]` and `[4]` below are these.
"""

import math
import warnings
from typing import NamedTuple

import numpy as np

with warnings.catch_warnings():
    # SWIG's types warn as Box2D is first imported; as an error that ends the process.
    warnings.simplefilter("ignore")
    from gymnasium.envs.box2d import bipedal_walker as official

# Box2D 2.3, b2Settings.h
LINEAR_SLOP = 0.005
ANGULAR_SLOP = 2.0 / 180.0 * math.pi
MAX_LINEAR_CORRECTION = 0.2
MAX_ANGULAR_CORRECTION = 8.0 / 180.0 * math.pi
MAX_TRANSLATION = 2.0
MAX_ROTATION = 0.5 * math.pi
SKIN = 2 * LINEAR_SLOP
"""Thickness of the skin around every polygon and edge [m] (b2_polygonRadius)."""

GRAVITY = -10.0
"""b2World's default [m/s²]."""

SECONDS = 1.0 / official.FPS
VELOCITY_ROUNDS = 6 * 30
POSITION_ROUNDS = 2 * 30
"""The numbers that gymnasium gives to `b2World.Step`."""


class Mass(NamedTuple):
    """What a body's shape and density make of it, by Gauss's formulas for polygons.

    Attributes:
        mass: [kg].
        inertia: about the centre of mass [kg m²].
        centre: of mass, in the coordinates of the shape [m].
    """

    mass: float
    inertia: float
    centre: tuple[float, float]


def mass_of(vertices: np.ndarray, density: float) -> Mass:
    """The mass of a polygon.

    Args:
        vertices: counter-clockwise [corners, 2].
        density: [kg/m²].

    Returns:
        Its mass.
    """
    following = np.roll(vertices, -1, axis=0)
    doubled = vertices[:, 0] * following[:, 1] - vertices[:, 1] * following[:, 0]
    area = doubled.sum() / 2
    centre = (doubled[:, None] * (vertices + following)).sum(0) / (6 * area)
    squares = (vertices * vertices + vertices * following + following * following).sum(1)
    mass = density * area
    inertia = density * (doubled * squares).sum() / 12 - mass * (centre**2).sum()
    return Mass(mass, inertia, (float(centre[0]), float(centre[1])))


def _corners(fixture: object) -> np.ndarray:
    return np.array(fixture.shape.vertices, np.float64)  # type: ignore[attr-defined]


HULL_CORNERS = _corners(official.HULL_FD)
_THIGH, _SHIN = _corners(official.LEG_FD), _corners(official.LOWER_FD)
LEG_CORNERS = np.stack([_THIGH, _SHIN, _THIGH, _SHIN])
"""[4, corners, 2]; corner i and the next bound side i."""

_HULL_MASS = mass_of(HULL_CORNERS, official.HULL_FD.density)
_LEG_MASSES = [mass_of(corners, official.LEG_FD.density) for corners in LEG_CORNERS]
HULL_CENTRE = np.array(_HULL_MASS.centre)
"""The hull's centre of mass in the coordinates of its shape [m]; those of the legs are 0."""

INVERSE_MASS = np.array([1 / part.mass for part in (_HULL_MASS, *_LEG_MASSES)])
"""[5] [1/kg]."""
INVERSE_INERTIA = np.array([1 / part.inertia for part in (_HULL_MASS, *_LEG_MASSES)])
"""[5] [1/(kg m²)]."""

FRICTION = math.sqrt(official.LEG_FD.friction * official.FRICTION)
"""Between a leg and the ground: b2MixFriction of the two."""

HINGES = ((0, 1), (1, 2), (0, 3), (3, 4))
"""The bodies of each hinge."""
HINGE_ORDER = (3, 2, 0, 1)
"""The order in which Box2D solves them: it goes from body to body along the hinges, and begins with
the body that was made last."""

_HIP = np.array([0.0, official.LEG_DOWN]) - HULL_CENTRE
_BOTTOM, _TOP = np.array([0.0, -official.LEG_H / 2]), np.array([0.0, official.LEG_H / 2])
ANCHORS = np.array([(_HIP, _TOP), (_BOTTOM, _TOP), (_HIP, _TOP), (_BOTTOM, _TOP)])
"""Of each hinge in its two bodies, from their centres of mass, [4, 2 bodies, 2] [m]."""

# These four are not named in gymnasium's module; `BipedalWalker.reset` has them.
LOWER = np.array([-0.8, -1.6, -0.8, -1.6])
UPPER = np.array([1.1, -0.1, 1.1, -0.1])
"""Limits of the hinges' angles [4] [rad]."""
START_TILTS = np.array([-0.05, -0.05, 0.05, 0.05])
"""Angles of the legs' parts as they are made [4] [rad]."""
_MADE = np.array([0.0, *START_TILTS])
REFERENCE = np.array([_MADE[b] - _MADE[a] for a, b in HINGES])
"""What counts as angle 0 of each hinge: pybox2d takes the angle at which it is made [4] [rad]."""
SPEEDS = np.array([official.SPEED_HIP, official.SPEED_KNEE] * 2, np.float64)
"""Of the motors [4] [rad/s]."""
TORQUE = float(official.MOTORS_TORQUE)
"""The most a motor gives [N m]."""

TERRAIN_STEP = official.TERRAIN_STEP
TERRAIN_LENGTH = official.TERRAIN_LENGTH
CORNER_X = (np.arange(TERRAIN_LENGTH) * TERRAIN_STEP).astype(np.float32)
"""Where the corners of the ground are [TERRAIN_LENGTH] [m]."""
NUM_EDGES = TERRAIN_LENGTH - 1
GOAL = (official.TERRAIN_LENGTH - official.TERRAIN_GRASS) * official.TERRAIN_STEP
"""Beyond it the episode ends [m]."""
