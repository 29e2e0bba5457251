"""Backend `lean`: gymnasium's bipedal walker on Box2D, the same numbers in half the time.

Body, terrain and rewards are built from `hitl_jax.walker.bipedal`; the world and its solver are
Box2D's own (`lean_box2d`). Every bit of an episode is as in gymnasium's class. Observations,
rewards and the lidar over plain terrain (`lean_lidar`) are computed for all walkers of a process at
once.
"""

import numpy as np

from hitl_jax.envs import HARDCORE_WALKER
from hitl_jax.envs.base import Command
from hitl_jax.envs.lean_box2d import Box2dWalker
from hitl_jax.envs.lean_lidar import CORNER_X, ROUNDS_AS_BOX2D, PlainLidar
from hitl_jax.envs.shared import SharedArrays
from hitl_jax.walker import bipedal

_SPEEDS = np.array([bipedal.SPEED_HIP, bipedal.SPEED_KNEE] * 2, np.float32)
"""Target speeds of the joints' motors [rad/s]."""


class LeanWalkers:
    """The walkers of one process (`worker.Walkers`).

    Attributes:
        observation_size: 24.
        action_size: 4.
    """

    observation_size = 24
    action_size = 4

    def __init__(self, env_id: str, num_walkers: int):
        """Makes the walkers; each waits for its first RESET.

        Args:
            env_id: one of `OUR_WALKERS`.
            num_walkers: of this process.
        """
        hardcore = env_id == HARDCORE_WALKER
        self._limit = bipedal.MOST_HARDCORE_STEPS if hardcore else bipedal.MOST_STEPS
        self._walkers = [Box2dWalker(hardcore) for _ in range(num_walkers)]
        self._plain_lidar = PlainLidar(num_walkers)
        self._steps = np.zeros(num_walkers, np.int64)
        self._shaping = np.zeros(num_walkers)

    def tick(self, arrays: SharedArrays) -> None:
        """Does each walker's command; the pool has set reward and flags to 0."""
        stepped = arrays.command == Command.STEP
        for index in np.flatnonzero(arrays.command == Command.RESET).tolist():
            walker = self._walkers[index]
            walker.start(int(arrays.seed[index]))
            self._steps[index] = 0
            if walker.is_plain:
                self._plain_lidar.set(index, walker.heights)
        strength = np.clip(np.abs(arrays.action), 0, 1)
        speeds = (_SPEEDS * np.sign(arrays.action)).tolist()
        torques = (bipedal.MOTORS_TORQUE * strength).tolist()
        for index in np.flatnonzero(stepped).tolist():
            self._walkers[index].step(speeds[index], torques[index])
        moved = np.flatnonzero(arrays.command != Command.IDLE)
        if moved.size:
            self._write_results(arrays, moved, stepped[moved], strength[moved])

    def terrain(self, index: int) -> tuple[list[float], list[float]]:
        """Corners of a walker's ground: x and heights [m]."""
        return list(CORNER_X), list(self._walkers[index].heights)

    def bodies(self, index: int) -> list[tuple[float, float, float]]:
        """Place [m] and angle [rad] of a walker's hull, thigh, shin, thigh and shin."""
        walker = self._walkers[index]
        return [(*body.position, body.angle) for body in (walker.hull, *walker.legs)]

    def _write_results(
        self, arrays: SharedArrays, moved: np.ndarray, stepped: np.ndarray, strength: np.ndarray
    ) -> None:
        """Writes observation, reward and flags of walkers that stepped or reset.

        The operations, and their order, are gymnasium's.

        Args:
            arrays: of the tick.
            moved: indices of these walkers, int [M].
            stepped: which of them stepped, bool [M].
            strength: absolute actions, clipped to 1, float32 [M, 4].
        """
        raw = np.array([self._walkers[index].read() for index in moved.tolist()]).T
        # A slice of all walkers is faster than an index array.
        rows = slice(None) if moved.size == len(self._walkers) else moved
        place, over = raw[14:16], raw[16] > 0
        arrays.observation[rows, :14] = _proprioception(raw).T
        arrays.observation[rows, 14:] = self._lidar(moved, place)
        shaping = 130 * place[0] / bipedal.SCALE - 5.0 * np.abs(raw[0])
        reward = (shaping - self._shaping[rows]).astype(np.float32)
        for effort in (np.float32(0.00035 * bipedal.MOTORS_TORQUE) * strength).T:
            reward -= effort
        fallen = over | (place[0] < 0)
        reward[fallen] = -100
        self._shaping[rows] = shaping
        self._steps[rows] += stepped
        arrays.reward[rows] = np.where(stepped, reward, 0)
        arrays.terminated[rows] = stepped & (fallen | (place[0] > bipedal.GOAL))
        arrays.truncated[rows] = stepped & (self._steps[rows] >= self._limit)

    def _lidar(self, moved: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Fractions of the lidar's rays, [M, 10]."""
        fractions = self._plain_lidar.fractions(moved, place)
        for row, index in enumerate(moved.tolist()):
            if not (self._walkers[index].is_plain and ROUNDS_AS_BOX2D):
                fractions[row] = list(self._walkers[index].lidar())
        return fractions


def _proprioception(raw: np.ndarray) -> np.ndarray:
    """The 14 numbers before lidar, from `Box2dWalker.read`; [14, M]."""
    state = raw[:14].copy()
    state[1] = 2.0 * raw[1] / bipedal.FPS
    state[2] = 0.3 * raw[2] * (bipedal.VIEWPORT_W / bipedal.SCALE) / bipedal.FPS
    state[3] = 0.3 * raw[3] * (bipedal.VIEWPORT_H / bipedal.SCALE) / bipedal.FPS
    state[5:11:5] /= bipedal.SPEED_HIP
    state[6:12:5] += 1.0
    state[7:13:5] /= bipedal.SPEED_KNEE
    return state
