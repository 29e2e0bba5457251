"""`VisibleWalker`: one lean walker in this process, whose bodies and terrain can be drawn."""

from typing import Any, NamedTuple

import numpy as np

from hitl_jax.envs import WALKER, box2d
from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SharedArrays
from hitl_jax.walker import bipedal

LIDAR = slice(14, 24)
"""Lidar fractions in an observation."""

FEET = (8, 13)
"""Ground contact of the two feet in an observation."""


class Answer(NamedTuple):
    """The results of a step.

    Attributes:
        observation: s_{t+1}, float32 [24].
        reward: r(s, a).
        terminated: whether the walker fell or reached the end of the terrain.
        truncated: whether the step reached the time limit.
    """

    observation: np.ndarray
    reward: float
    terminated: bool
    truncated: bool


class VisibleWalker:
    """A walker with the numbers of backend `lean`, for live sessions and films."""

    def __init__(self) -> None:
        """Waits for the first reset.

        Raises:
            ImportError: if Box2D is missing; one line that says what to install.
        """
        box2d.require("the live walker")
        from hitl_jax.envs.lean import LeanWalkers

        self._walkers = LeanWalkers(WALKER, 1)
        self._arrays = SharedArrays(
            action=np.zeros((1, 4), np.float32),
            observation=np.zeros((1, 24), np.float32),
            seed=np.zeros(1, np.uint32),
            reward=np.zeros(1, np.float32),
            command=np.zeros(1, np.uint8),
            terminated=np.zeros(1, bool),
            truncated=np.zeros(1, bool),
        )

    def reset(self, seed: int) -> np.ndarray:
        """Begins a seed's episode; returns the first observation, float32 [24]."""
        self._arrays.seed[0] = seed
        return self._tick(Command.RESET).observation

    def step(self, action: np.ndarray) -> Answer:
        """Makes one step of 0.02 s with an action [4]."""
        self._arrays.action[0] = action
        return self._tick(Command.STEP)

    def _tick(self, command: int) -> Answer:
        """Does a command and reads the results."""
        arrays = self._arrays
        arrays.command[0] = command
        self._walkers.tick(arrays)
        return Answer(
            arrays.observation[0].copy(),
            float(arrays.reward[0]),
            bool(arrays.terminated[0]),
            bool(arrays.truncated[0]),
        )

    def terrain(self) -> dict[str, list[float]]:
        """Corners of the ground: lists `x` and `y` [m]."""
        x, y = self._walkers.terrain(0)
        return {"x": [round(v, 3) for v in x], "y": [round(v, 3) for v in y]}

    def bodies(self) -> list[tuple[float, ...]]:
        """Place [m] and angle [rad] of hull, thigh, shin, thigh and shin."""
        return [tuple(round(v, 4) for v in body) for body in self._walkers.bodies(0)]


def shapes() -> dict[str, Any]:
    """What the page draws and never changes: outlines [m], lidar rays, and the goal's x [m]."""
    return {
        "shapes": outlines(),
        "lidar": {"angles": list(bipedal.LIDAR_ANGLES), "range": bipedal.LIDAR_RANGE},
        "goal": bipedal.GOAL,
    }


def outlines() -> list[list[tuple[float, float]]]:
    """Corners of hull, thigh, shin, thigh and shin, each in the frame of its body [m]."""
    hull = [(x / bipedal.SCALE, y / bipedal.SCALE) for x, y in bipedal.HULL_POLY]
    thigh, shin = (_box(width, bipedal.LEG_H) for width in (bipedal.LEG_W, bipedal.SHIN_W))
    return [hull, thigh, shin, thigh, shin]


def _box(width: float, height: float) -> list[tuple[float, float]]:
    half_width, half_height = width / 2, height / 2
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return [(x * half_width, y * half_height) for x, y in corners]
