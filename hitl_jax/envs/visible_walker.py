"""One Box2D walker in this process, with its bodies and terrain for drawing.

It plays as a walker of the lean pool does.
"""

from typing import Any, NamedTuple

import numpy as np

from hitl_jax.envs import WALKER, box2d
from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SharedArrays
from hitl_jax.walker import bipedal

LIDAR = slice(14, 24)
"""Where an observation has the lidar: the share of its range that each ray reaches."""

FEET = (8, 13)
"""Where an observation has whether each foot touches the ground."""


class StepResult(NamedTuple):
    """The result of a step.

    Attributes:
        observation: s_{t+1}, [24].
        reward: r(s, a).
        terminated: whether the walker fell or reached the end.
        truncated: whether the time limit was reached.
    """

    observation: np.ndarray
    reward: float
    terminated: bool
    truncated: bool


class VisibleWalker:
    """Plays one walker, step by step."""

    def __init__(self) -> None:
        """Makes the walker; `reset` begins its first episode.

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
        """Begins the episode of a seed; its first observation, [24]."""
        self._arrays.seed[0] = seed
        return self._tick(Command.RESET).observation

    def step(self, action: np.ndarray) -> StepResult:
        """Plays one step of 0.02 s with an action, [4]."""
        self._arrays.action[0] = action
        return self._tick(Command.STEP)

    def _tick(self, command: int) -> StepResult:
        arrays = self._arrays
        arrays.command[0] = command
        self._walkers.tick(arrays)
        return StepResult(
            arrays.observation[0].copy(),
            float(arrays.reward[0]),
            bool(arrays.terminated[0]),
            bool(arrays.truncated[0]),
        )

    def terrain(self) -> dict[str, list[float]]:
        """Corners of the ground [m]."""
        x, y = self._walkers.terrain(0)
        return {"x": [round(v, 3) for v in x], "y": [round(v, 3) for v in y]}

    def bodies(self) -> list[tuple[float, ...]]:
        """Place [m] and angle [rad] of hull, thigh, shin, thigh and shin."""
        return [tuple(round(v, 4) for v in body) for body in self._walkers.bodies(0)]


def shapes() -> dict[str, Any]:
    """What stays the same in an episode: outlines [m], lidar rays [rad, m] and the goal [m]."""
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
