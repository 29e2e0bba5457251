"""Gymnasium's bipedal walker, the same numbers in half the time.

The world and its solver are the official ones, Box2D through gymnasium's own class. What is done
differently leaves every bit of an episode as it was:

- The edges of the terrain share a few static bodies instead of having one each: the solver visits
  every body at each step.
- Lidar over plain terrain is computed here, in Box2D's own order of float32 operations, for all
  walkers of a process at once; through Box2D each ray calls back into Python.
- Observations and rewards are computed for all walkers at once.
- The world is dropped whole at a reset, not body by body; clouds are drawn from the generator, not
  built.
- Who touches the ground is told by the address of a body, not by comparing proxies.
"""

import math
import platform
import types
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
from Box2D import b2ContactListener, b2World  # type: ignore[import-untyped]
from gymnasium.envs.box2d import bipedal_walker as official

from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SharedArrays

_ANGLES = [1.5 * ray / 10.0 for ray in range(10)]
_REACH = np.array(
    [
        [math.sin(angle) * official.LIDAR_RANGE for angle in _ANGLES],
        [-math.cos(angle) * official.LIDAR_RANGE for angle in _ANGLES],
    ]
)
_WINDOW = math.ceil(_REACH[0].max() / official.TERRAIN_STEP) + 3
"""Edges that a walker's rays may meet, with one to spare on either side."""

_BODIES = 20
"""Bodies that the edges share in turn. Contacts with one body are not independent of each other in
Box2D; edges of one body are so far apart (9 m) that a walker (at most 5 m) meets one at a time."""

_CLOUD_DRAWS = official.TERRAIN_LENGTH // 20 * 11
"""Numbers that gymnasium draws for its clouds: of each, a place and five corners."""

# Elsewhere the compiler of Box2D may have fused a product and a sum, which rounds differently.
_ROUNDS_ALIKE = platform.machine().lower() in ("x86_64", "amd64")

_SPEEDS = np.array([official.SPEED_HIP, official.SPEED_KNEE] * 2, np.float32)
_GOAL = (official.TERRAIN_LENGTH - official.TERRAIN_GRASS) * official.TERRAIN_STEP


class _Recorder:
    """Takes the place of the world while gymnasium's class draws a terrain: keeps the shapes."""

    def __init__(self) -> None:
        self.shapes: list[tuple[Any, Sequence[tuple[float, float]]]] = []

    def CreateStaticBody(self, fixtures: Any) -> Any:
        """Keeps a shape; gymnasium colours what it gets back."""
        self.shapes.append((fixtures, tuple(fixtures.shape.vertices)))
        return types.SimpleNamespace()


def _blank() -> Any:
    """Takes the place of a fixture definition, which copies its vertices into Box2D."""
    return types.SimpleNamespace(shape=types.SimpleNamespace(vertices=()))


class _Contacts(b2ContactListener):
    """Notes on a walker's parts whether they touch the ground, as gymnasium's listener does."""

    def __init__(self, walker: "_Walker"):
        super().__init__()
        assert walker.hull is not None
        self._walker = walker
        self._hull = int(walker.hull.this)
        self._feet = {int(foot.this): foot for foot in (walker.legs[1], walker.legs[3])}

    def BeginContact(self, contact: Any) -> None:
        """The hull ends the episode, a foot stands."""
        for body in (int(contact.fixtureA.body.this), int(contact.fixtureB.body.this)):
            if body in self._feet:
                self._feet[body].ground_contact = True
            elif body == self._hull:
                self._walker.game_over = True

    def EndContact(self, contact: Any) -> None:
        """A foot has left one of the things that it stood on."""
        for body in (int(contact.fixtureA.body.this), int(contact.fixtureB.body.this)):
            if body in self._feet:
                self._feet[body].ground_contact = False


class _Walker(official.BipedalWalker):
    """One walker, its terrain on few bodies; advanced and read from outside."""

    def __init__(self, hardcore: bool):
        super().__init__(hardcore=hardcore)
        self._edge, self.fd_edge = self.fd_edge, _blank()
        self._polygon, self.fd_polygon = self.fd_polygon, _blank()
        self.only_edges = False

    def start(self, seed: int) -> None:
        """Begins the episode of a seed in a new world."""
        self.terrain = []  # Nothing to destroy: the old world goes as a whole.
        self.world = b2World()
        self.reset(seed=seed)

    def _generate_terrain(self, hardcore: bool) -> None:
        world, self.world = self.world, _Recorder()
        super()._generate_terrain(hardcore)
        recorder, self.world = self.world, world
        obstacles = [vertices for kind, vertices in recorder.shapes if kind is self.fd_polygon]
        edges = [vertices for kind, vertices in recorder.shapes if kind is self.fd_edge]
        for vertices in obstacles:
            self._polygon.shape.vertices = vertices
            world.CreateStaticBody(fixtures=self._polygon)
        bodies = [world.CreateStaticBody() for _ in range(_BODIES)]
        for place, vertices in enumerate(edges):
            self._edge.shape.vertices = vertices
            bodies[place % _BODIES].CreateFixture(self._edge)
        self.only_edges = not obstacles

    def _generate_clouds(self) -> None:
        self.np_random.random(_CLOUD_DRAWS)

    def step(self, action: np.ndarray) -> Any:
        """The step without motors that ends gymnasium's reset; what it saw is read from outside."""
        # The world keeps no reference of its own to its listener.
        self.world.contactListener_bug_workaround = _Contacts(self)
        self.world.contactListener = self.world.contactListener_bug_workaround
        self.advance([0.0] * 4, [0.0] * 4)
        return None, 0.0, False, False, {}

    def advance(self, speeds: list[float], torques: list[float]) -> None:
        """Sets the motors and steps the world."""
        for joint, speed, torque in zip(self.joints, speeds, torques, strict=True):
            joint.motorSpeed = speed
            joint.maxMotorTorque = torque
        self.world.Step(1.0 / official.FPS, 6 * 30, 2 * 30)

    def read(self) -> tuple[float, ...]:
        """Place, velocity and angle of the hull, of the joints, contacts; see `_answer`."""
        hull, legs = self.hull, self.legs
        assert hull is not None
        place, velocity = hull.position, hull.linearVelocity
        hip, knee, other_hip, other_knee = self.joints
        return (
            hull.angle,
            hull.angularVelocity,
            velocity.x,
            velocity.y,
            hip.angle,
            hip.speed,
            knee.angle,
            knee.speed,
            legs[1].ground_contact,
            other_hip.angle,
            other_hip.speed,
            other_knee.angle,
            other_knee.speed,
            legs[3].ground_contact,
            place.x,
            place.y,
            self.game_over,
        )

    def cast(self) -> Iterator[float]:
        """Box2D's own lidar."""
        assert self.hull is not None
        place = self.hull.position
        for ray, (x, y) in zip(self.lidar, _REACH.T.tolist(), strict=True):
            ray.fraction = 1.0
            self.world.RayCast(ray, place, (place.x + x, place.y + y))
            yield ray.fraction


class _Edges:
    """The edges of several plain terrains, and where rays meet them as Box2D computes it.

    All arithmetic is float32, one operation at a time, in the order of `b2EdgeShape::RayCast`. The
    result of Box2D's search over its tree is the least fraction of any edge, in whatever order it
    meets them.
    """

    def __init__(self, num_walkers: int):
        self._columns = np.zeros((7, num_walkers, official.TERRAIN_LENGTH - 1), np.float32)

    def set(self, walker: int, x: Sequence[float], y: Sequence[float]) -> None:
        """Takes the terrain of a walker: the corners of its edges."""
        corner = np.array([x, y], np.float32)
        start, along = corner[:, :-1], np.diff(corner)
        squares = along * along
        length = np.sqrt(squares[0] + squares[1])
        inverse = np.float32(1.0) / length
        normal = np.stack([along[1] * inverse, -along[0] * inverse])
        self._columns[:, walker] = *start, *normal, *along, squares[0] + squares[1]

    def fractions(self, walkers: np.ndarray, place: np.ndarray) -> np.ndarray:
        """How far each ray gets, as a fraction of its length.

        Args:
            walkers: whose terrains, int [M].
            place: of their hulls, float64 [2, M]; the values of float32 numbers.

        Returns:
            Fractions, 1 where a ray meets nothing, float32 [M, 10].
        """
        first = np.floor(place[0] / official.TERRAIN_STEP).astype(np.int64) - 1
        last = self._columns.shape[2] - _WINDOW
        window = np.clip(first, 0, last)[:, None] + np.arange(_WINDOW)
        edges = self._columns[:, walkers[:, None], window][:, :, None]  # [7, M, 1, window]
        start_x, start_y, normal_x, normal_y, along_x, along_y, square = edges
        here_x, here_y = place.astype(np.float32)[:, :, None, None]
        there = (place[:, :, None] + _REACH[:, None]).astype(np.float32)[..., None]
        ray_x, ray_y = there[0] - here_x, there[1] - here_y
        above = normal_x * (start_x - here_x) + normal_y * (start_y - here_y)
        toward = normal_x * ray_x + normal_y * ray_y
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = above / toward
            offset_x = here_x + fraction * ray_x - start_x
            offset_y = here_y + fraction * ray_y - start_y
            share = (offset_x * along_x + offset_y * along_y) / square
            # A ray along an edge gives what is not a number, and no hit.
            met = (fraction >= 0) & (fraction <= 1) & (share >= 0) & (share <= 1)
        return np.where(met, fraction, np.float32(1.0)).min(axis=2)


class LeanWalkers:
    """The walkers of one process; see the module for what they have of the official ones.

    Attributes:
        observation_size: 24.
        action_size: 4.
    """

    observation_size = 24
    action_size = 4

    def __init__(self, env_id: str, num_walkers: int):
        """Makes the walkers; each waits for its first RESET.

        Args:
            env_id: one of `LEAN_WALKERS`.
            num_walkers: of this process.
        """
        spec = gymnasium.spec(env_id)
        self._limit = spec.max_episode_steps
        hardcore = bool(spec.kwargs.get("hardcore", False))
        self._walkers = [_Walker(hardcore) for _ in range(num_walkers)]
        self._edges = _Edges(num_walkers)
        self._steps = np.zeros(num_walkers, np.int64)
        self._shaping = np.zeros(num_walkers)

    def tick(self, arrays: SharedArrays) -> None:
        """Does what is asked of each walker; the pool has cleared reward and flags."""
        stepped = arrays.command == Command.STEP
        for index in np.flatnonzero(arrays.command == Command.RESET).tolist():
            walker = self._walkers[index]
            walker.start(int(arrays.seed[index]))
            self._steps[index] = 0
            if walker.only_edges:
                self._edges.set(index, walker.terrain_x, walker.terrain_y)
        strength = np.clip(np.abs(arrays.action), 0, 1)
        speeds = (_SPEEDS * np.sign(arrays.action)).tolist()
        torques = (official.MOTORS_TORQUE * strength).tolist()
        for index in np.flatnonzero(stepped).tolist():
            self._walkers[index].advance(speeds[index], torques[index])
        played = np.flatnonzero(arrays.command != Command.IDLE)
        if played.size:
            self._answer(arrays, played, stepped[played], strength[played])

    def _answer(
        self, arrays: SharedArrays, played: np.ndarray, stepped: np.ndarray, strength: np.ndarray
    ) -> None:
        """Observation, reward and end of the walkers that played; the sums are gymnasium's own."""
        raw = np.array([self._walkers[index].read() for index in played.tolist()]).T
        place, over = raw[14:16], raw[16] > 0
        arrays.observation[played, :14] = _proprioception(raw).T
        arrays.observation[played, 14:] = self._lidar(played, place)
        shaping = 130 * place[0] / official.SCALE - 5.0 * np.abs(raw[0])
        reward = (shaping - self._shaping[played]).astype(np.float32)
        for effort in strength.T:
            reward -= np.float32(0.00035 * official.MOTORS_TORQUE) * effort
        fallen = over | (place[0] < 0)
        reward[fallen] = -100
        self._shaping[played] = shaping
        self._steps[played] += stepped
        arrays.reward[played] = np.where(stepped, reward, 0)
        arrays.terminated[played] = stepped & (fallen | (place[0] > _GOAL))
        arrays.truncated[played] = stepped & (self._steps[played] >= self._limit)

    def _lidar(self, played: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Fractions of the rays, [M, 10]."""
        fractions = self._edges.fractions(played, place)
        for row, index in enumerate(played.tolist()):
            if not (self._walkers[index].only_edges and _ROUNDS_ALIKE):
                fractions[row] = list(self._walkers[index].cast())
        return fractions


def _proprioception(raw: np.ndarray) -> np.ndarray:
    """The 14 numbers before lidar, from what `_Walker.read` gives; [14, M]."""
    state = raw[:14].copy()
    state[1] = 2.0 * raw[1] / official.FPS
    state[2] = 0.3 * raw[2] * (official.VIEWPORT_W / official.SCALE) / official.FPS
    state[3] = 0.3 * raw[3] * (official.VIEWPORT_H / official.SCALE) / official.FPS
    state[[5, 10]] /= official.SPEED_HIP
    state[[6, 11]] += 1.0
    state[[7, 12]] /= official.SPEED_KNEE
    return state
