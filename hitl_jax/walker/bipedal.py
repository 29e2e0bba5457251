"""BipedalWalker-v3's constants and its terrain draw; all our walkers are built from them.

The numbers, and the order in which random numbers are drawn, are those of gymnasium 1.4,
gymnasium/envs/box2d/bipedal_walker.py (tests compare the two). Lengths are in metres unless a
comment says otherwise. This module imports neither gymnasium nor Box2D nor JAX.
"""

import math
from typing import NamedTuple

import numpy as np

FPS = 50
"""Steps of the walker per second."""
SCALE = 30.0
"""Pixels per metre of gymnasium's pictures; some numbers below are given in pixels."""
VIEWPORT_W, VIEWPORT_H = 600, 400
"""Size of gymnasium's pictures [pixels]."""

MOST_STEPS, MOST_HARDCORE_STEPS = 1600, 2000
"""Time limits [steps], of gymnasium's BipedalWalker-v3 and BipedalWalkerHardcore-v3."""

# The solver: arguments of `b2World.Step`.
SECONDS = 1.0 / FPS
VELOCITY_ITERATIONS, POSITION_ITERATIONS = 6 * 30, 2 * 30

# The body: a hull and two legs. A hip joins each thigh to the hull, a knee each shin to its thigh.
HULL_POLY = ((34, -8), (34, 1), (6, 9), (-30, 9), (-30, -8))
"""Corners, counter-clockwise from the right bottom one, where Box2D begins [pixels]."""
LEG_DOWN = -8 / SCALE
"""Height of the hips in the hull's frame."""
LEG_W, LEG_H = 8 / SCALE, 34 / SCALE
SHIN_W = 0.8 * LEG_W
HULL_DENSITY, LEG_DENSITY = 5.0, 1.0
"""[kg/m²]"""
HULL_FRICTION, LEG_FRICTION, GROUND_FRICTION = 0.1, 0.2, 2.5
"""Coefficients; the legs' is Box2D's default."""
SIDES = (-1, 1)
"""Sides of the legs, in the order in which they are made."""
LEG_TILT = 0.05
"""Angle at which a leg is made, times its side [rad]."""
HIP_LIMITS, KNEE_LIMITS = (-0.8, 1.1), (-1.6, -0.1)
"""Least and greatest angle of a joint [rad]."""
MOTORS_TORQUE = 80
"""The most torque a motor gives [N m]."""
SPEED_HIP, SPEED_KNEE = 4, 6
"""Target speeds of the motors [rad/s]."""
INITIAL_RANDOM = 5
"""The largest random force on the hull in the first step [N]."""

# The ground: a line through corners, one every `TERRAIN_STEP`.
TERRAIN_STEP = 14 / SCALE
TERRAIN_LENGTH = 200
"""Number of corners."""
TERRAIN_HEIGHT = VIEWPORT_H / SCALE / 4
TERRAIN_GRASS = 10
"""A stretch of plain ground has fewer corners than this, and at least half as many."""
TERRAIN_STARTPAD = 20
"""Corners at the same height at the start."""
GOAL = (TERRAIN_LENGTH - TERRAIN_GRASS) * TERRAIN_STEP
"""The episode ends where the hull's x is larger."""
START_X = TERRAIN_STEP * TERRAIN_STARTPAD / 2
START_Y = TERRAIN_HEIGHT + 2 * LEG_H
"""Height of the hull at the start; `START_X` is its x."""

# Lidar: rays from the hull, from straight down to 77 degrees forward.
LIDAR_RANGE = 160 / SCALE
LIDAR_ANGLES = tuple(1.5 * ray / 10.0 for ray in range(10))
LIDAR_REACH = tuple(
    (math.sin(angle) * LIDAR_RANGE, -math.cos(angle) * LIDAR_RANGE) for angle in LIDAR_ANGLES
)
"""End of each ray, from the hull's position."""

_CLOUD_DRAWS = TERRAIN_LENGTH // 20 * 11
"""Random numbers that gymnasium draws for its clouds: a place and five corners of each."""
_STRETCH = (TERRAIN_GRASS // 2, TERRAIN_GRASS)
_GRASS, _STUMP, _STAIRS, _PIT = range(4)
_STAIR_WIDTH, _PIT_DEPTH = 4, 4
"""In `TERRAIN_STEP`."""


class Box(NamedTuple):
    """An obstacle, by its sides [m]: a stump, a stair or a pit's wall."""

    left: float
    bottom: float
    right: float
    top: float


class Start(NamedTuple):
    """The random start of an episode.

    Attributes:
        heights: of the ground's corners, `TERRAIN_LENGTH` of them [m].
        boxes: obstacles, in the order in which gymnasium builds them.
        push: horizontal force on the hull in the first step [N].
    """

    heights: list[float]
    boxes: list[Box]
    push: float


def random_numbers(seed: int) -> np.random.Generator:
    """The random number generator that gymnasium makes of an episode's seed (at least 0)."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


def draw_start(rng: np.random.Generator, hardcore: bool = False) -> Start:
    """Draws the start of an episode, equal to gymnasium's `reset` to the last bit.

    Args:
        rng: generator of the episode's seed; it is left as gymnasium's `reset` leaves it.
        hardcore: whether the terrain has stumps, stairs and pits.
    """
    heights, boxes = draw_hardcore(rng) if hardcore else (draw_plain(rng), [])
    rng.random(_CLOUD_DRAWS)
    return Start(heights, boxes, rng.uniform(-INITIAL_RANDOM, INITIAL_RANDOM))


def draw_plain(rng: np.random.Generator) -> list[float]:
    """Draws the heights of plain terrain [m], as gymnasium draws them.

    A flat start, then stretches of 5 to 9 corners; the first corner of each repeats the height
    before.
    """
    height, velocity = TERRAIN_HEIGHT, 0.0
    heights = [height] * TERRAIN_STARTPAD
    stretch = int(rng.integers(*_STRETCH))
    while len(heights) < TERRAIN_LENGTH:
        heights.append(height)
        pushes = min(stretch - 1, TERRAIN_LENGTH - len(heights))
        for push in (rng.uniform(-1, 1, pushes) / SCALE).tolist():
            velocity = _next_slope(velocity, height, push)
            height += velocity
            heights.append(height)
        if pushes == stretch - 1:  # Gymnasium draws the next length here, at the last corner too.
            stretch = int(rng.integers(*_STRETCH))
    return heights


def draw_hardcore(rng: np.random.Generator) -> tuple[list[float], list[Box]]:
    """Draws heights [m] and obstacles of hardcore terrain, as gymnasium draws them.

    Plain stretches alternate with a stump, stairs or a pit.
    """
    heights: list[float] = []
    boxes: list[Box] = []
    height, velocity = TERRAIN_HEIGHT, 0.0
    base, size, up = height, 0, 1  # The obstacle's.
    kind, left, begins = _GRASS, TERRAIN_STARTPAD, False
    for corner in range(TERRAIN_LENGTH):
        x = corner * TERRAIN_STEP
        if begins and kind != _GRASS:
            base = height
            up = 1 if kind == _STAIRS and rng.random() > 0.5 else -1
            size = int(rng.integers(*((1, 3) if kind == _STUMP else (3, 5))))
            left = {_STUMP: size, _STAIRS: size * _STAIR_WIDTH, _PIT: size + 2}[kind]
            boxes += _obstacle(kind, x, base, size, up)
        elif kind == _GRASS and not begins:
            push = rng.uniform(-1, 1) / SCALE if corner > TERRAIN_STARTPAD else 0.0
            velocity = _next_slope(velocity, height, push)
            height += velocity
        elif kind == _STAIRS:
            tread = (size * _STAIR_WIDTH - left - up) / _STAIR_WIDTH
            height = base + tread * up * TERRAIN_STEP
        elif kind == _PIT:
            height = base - (_PIT_DEPTH * TERRAIN_STEP if left > 1 else 0.0)
        heights.append(height)
        left -= 1
        begins = left == 0
        if begins:
            left = int(rng.integers(*_STRETCH))  # Gymnasium draws a length before obstacles too.
            kind = int(rng.integers(_STUMP, _PIT + 1)) if kind == _GRASS else _GRASS
    return heights, boxes


def _next_slope(velocity: float, height: float, push: float) -> float:
    """The rise to the next corner [m]; the ground tends back to the height of its start."""
    toward = 0.01 if height < TERRAIN_HEIGHT else -0.01 if height > TERRAIN_HEIGHT else 0.0
    return 0.8 * velocity + toward + push


def _obstacle(kind: int, x: float, y: float, size: int, up: int) -> list[Box]:
    """Boxes of the obstacle at a corner (x, y): one stump, `size` stairs, or a pit's two walls."""
    step = TERRAIN_STEP
    if kind == _STUMP:
        return [Box(x, y, x + size * step, y + size * step)]
    if kind == _PIT:
        low, right = y - _PIT_DEPTH * step, x + step
        return [Box(x, low, right, y), Box(x + step * size, low, right + step * size, y)]
    return [
        Box(
            x + stair * _STAIR_WIDTH * step,
            y + (stair * up - 1) * step,
            x + (stair + 1) * _STAIR_WIDTH * step,
            y + stair * up * step,
        )
        for stair in range(size)
    ]
