"""BipedalWalker-v3 in numbers, and its terrain: what every walker here is built of.

The numbers, and the order in which random numbers are drawn, are those of gymnasium 1.4,
gymnasium/envs/box2d/bipedal_walker.py (tests compare them as long as it is there). Lengths are in
metres unless a comment says otherwise. Imports neither gymnasium nor Box2D nor JAX.
"""

import math
from typing import NamedTuple

import numpy as np

FPS = 50
"""Steps of the walker per second."""
SCALE = 30.0
"""Of gymnasium's pictures: pixels a metre; some numbers below are given in pixels."""
VIEWPORT_W, VIEWPORT_H = 600, 400
"""Size of gymnasium's pictures [pixels]."""

MOST_STEPS, MOST_HARDCORE_STEPS = 1600, 2000
"""Of an episode, by gymnasium's registrations of BipedalWalker-v3 and BipedalWalkerHardcore-v3."""

# The solver: arguments of `b2World.Step`.
SECONDS = 1.0 / FPS
VELOCITY_ROUNDS, POSITION_ROUNDS = 6 * 30, 2 * 30

# The body. A hull; two legs, each a thigh and a shin, joined by hip and knee.
HULL_POLY = ((34, -8), (34, 1), (6, 9), (-30, 9), (-30, -8))
"""Counter-clockwise from the right bottom corner, where Box2D begins [pixels]."""
LEG_DOWN = -8 / SCALE
"""Height of the hips in the hull."""
LEG_W, LEG_H = 8 / SCALE, 34 / SCALE
SHIN_W = 0.8 * LEG_W
HULL_DENSITY, LEG_DENSITY = 5.0, 1.0
"""[kg/m²]"""
HULL_FRICTION, LEG_FRICTION, GROUND_FRICTION = 0.1, 0.2, 2.5
"""The leg's is Box2D's default."""
SIDES = (-1, 1)
"""Of the legs, in the order in which they are made."""
LEG_TILT = 0.05
"""Angle at which a leg is made, times its side [rad]."""
HIP_LIMITS, KNEE_LIMITS = (-0.8, 1.1), (-1.6, -0.1)
"""Of the hinges' angles [rad]."""
MOTORS_TORQUE = 80
"""The most a motor gives [N m]."""
SPEED_HIP, SPEED_KNEE = 4, 6
"""Of the motors [rad/s]."""
INITIAL_RANDOM = 5
"""The most that the hull is pushed in the first step [N]."""

# The ground: corners, one every `TERRAIN_STEP`.
TERRAIN_STEP = 14 / SCALE
TERRAIN_LENGTH = 200
"""Corners."""
TERRAIN_HEIGHT = VIEWPORT_H / SCALE / 4
TERRAIN_GRASS = 10
"""Corners that no stretch of plain ground reaches; it has half as many at least."""
TERRAIN_STARTPAD = 20
"""Corners at the same height at the start."""
GOAL = (TERRAIN_LENGTH - TERRAIN_GRASS) * TERRAIN_STEP
"""Beyond it the episode ends."""
START_X = TERRAIN_STEP * TERRAIN_STARTPAD / 2
START_Y = TERRAIN_HEIGHT + 2 * LEG_H
"""Where the hull is made."""

# Lidar: rays from the hull, from straight down to 77 degrees forward.
LIDAR_RANGE = 160 / SCALE
LIDAR_ANGLES = tuple(1.5 * ray / 10.0 for ray in range(10))
LIDAR_REACH = tuple(
    (math.sin(angle) * LIDAR_RANGE, -math.cos(angle) * LIDAR_RANGE) for angle in LIDAR_ANGLES
)
"""Where each ray ends, seen from the hull."""

_CLOUD_DRAWS = TERRAIN_LENGTH // 20 * 11
"""Numbers that gymnasium draws for its clouds: of each, a place and five corners."""
_STRETCH = (TERRAIN_GRASS // 2, TERRAIN_GRASS)
_GRASS, _STUMP, _STAIRS, _PIT = range(4)
_STAIR_WIDTH, _PIT_DEPTH = 4, 4
"""In steps of the terrain."""


class Box(NamedTuple):
    """An obstacle: a stump, a stair or a pit's wall; its sides [m]."""

    left: float
    bottom: float
    right: float
    top: float


class Start(NamedTuple):
    """What an episode's seed decides.

    Attributes:
        heights: of the ground's corners, `TERRAIN_LENGTH` of them [m].
        boxes: obstacles, in the order in which gymnasium builds them.
        push: on the hull in the first step [N].
    """

    heights: list[float]
    boxes: list[Box]
    push: float


def random_numbers(seed: int) -> np.random.Generator:
    """The generator of an episode's seed, at least 0, as gymnasium seeds it."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


def draw_start(rng: np.random.Generator, hardcore: bool = False) -> Start:
    """Draws what gymnasium's `reset` draws, to the last bit.

    Args:
        rng: of the episode's seed; all that the episode needs is drawn from it.
        hardcore: whether the terrain has stumps, stairs and pits.
    """
    heights, boxes = draw_rough(rng) if hardcore else (draw_grass(rng), [])
    rng.random(_CLOUD_DRAWS)
    return Start(heights, boxes, rng.uniform(-INITIAL_RANDOM, INITIAL_RANDOM))


def draw_grass(rng: np.random.Generator) -> list[float]:
    """Heights of plain terrain [m], from the numbers that gymnasium's class draws.

    A flat start, then stretches of 5 to 9 corners, the first of which repeats the height before.
    """
    height, velocity = TERRAIN_HEIGHT, 0.0
    heights = [height] * TERRAIN_STARTPAD
    stretch = int(rng.integers(*_STRETCH))
    while len(heights) < TERRAIN_LENGTH:
        heights.append(height)
        pushes = min(stretch - 1, TERRAIN_LENGTH - len(heights))
        for push in (rng.uniform(-1, 1, pushes) / SCALE).tolist():
            velocity = _pushed(velocity, height, push)
            height += velocity
            heights.append(height)
        if pushes == stretch - 1:  # Gymnasium draws the next one here, at the last corner too.
            stretch = int(rng.integers(*_STRETCH))
    return heights


def draw_rough(rng: np.random.Generator) -> tuple[list[float], list[Box]]:
    """Heights [m] and obstacles of hardcore terrain, from the numbers that gymnasium's class draws.

    Plain stretches, and between every two of them a stump, stairs or a pit.
    """
    heights: list[float] = []
    boxes: list[Box] = []
    height, velocity = TERRAIN_HEIGHT, 0.0
    base, size, up = height, 0, 1  # Of the obstacle.
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
            velocity = _pushed(velocity, height, push)
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
            left = int(rng.integers(*_STRETCH))  # Gymnasium draws it before an obstacle too.
            kind = int(rng.integers(_STUMP, _PIT + 1)) if kind == _GRASS else _GRASS
    return heights, boxes


def _pushed(velocity: float, height: float, push: float) -> float:
    """How much the next corner is higher: the ground tends back to the height of its start."""
    toward = 0.01 if height < TERRAIN_HEIGHT else -0.01 if height > TERRAIN_HEIGHT else 0.0
    return 0.8 * velocity + toward + push


def _obstacle(kind: int, x: float, y: float, size: int, up: int) -> list[Box]:
    """What stands at a corner: a stump of a size, so many stairs, or the walls of a pit so wide."""
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
