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
- Plain terrain is drawn here, from the same random numbers.
- Who touches the ground is told by the address of a body, not by comparing proxies, and what
  Box2D says of every contact before and after solving it is answered at once.
"""

import itertools
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
_SPANS = np.ceil(_REACH[0] / official.TERRAIN_STEP).astype(int) + 3
"""Edges that each ray may meet, with one to spare on either side."""

_WINDOW = int(_SPANS.max())
_FIRST_PAIR = np.cumsum(_SPANS) - _SPANS
_PAIR_RAY = np.repeat(np.arange(len(_SPANS)), _SPANS)
_PAIR_EDGE = np.arange(_SPANS.sum()) - _FIRST_PAIR[_PAIR_RAY]
"""Of every ray with each edge that it may meet, P pairs: the ray, and the edge in the window."""

_BODIES = 20
"""Bodies that the edges share in turn. Contacts with one body are not independent of each other in
Box2D; edges of one body are so far apart (9 m) that a walker (at most 5 m) meets one at a time."""

_CLOUD_DRAWS = official.TERRAIN_LENGTH // 20 * 11
"""Numbers that gymnasium draws for its clouds: of each, a place and five corners."""

# Elsewhere the compiler of Box2D may have fused a product and a sum, which rounds differently.
_ROUNDS_ALIKE = platform.machine().lower() in ("x86_64", "amd64")

_SPEEDS = np.array([official.SPEED_HIP, official.SPEED_KNEE] * 2, np.float32)
_GOAL = (official.TERRAIN_LENGTH - official.TERRAIN_GRASS) * official.TERRAIN_STEP


def _draw_grass(rng: np.random.Generator) -> list[float]:
    """Heights of plain terrain [m], from the numbers that gymnasium's class draws.

    A flat start, then stretches of 5 to 9 corners, the first of which repeats the height before.
    """
    start, length = official.TERRAIN_HEIGHT, official.TERRAIN_LENGTH
    stretches = official.TERRAIN_GRASS // 2, official.TERRAIN_GRASS
    height, velocity = start, 0.0
    heights = [height] * official.TERRAIN_STARTPAD
    stretch = int(rng.integers(*stretches))
    while len(heights) < length:
        heights.append(height)
        pushes = min(stretch - 1, length - len(heights))
        for push in (rng.uniform(-1, 1, pushes) / official.SCALE).tolist():
            toward = 0.01 if height < start else -0.01 if height > start else 0.0
            velocity = 0.8 * velocity + toward + push
            height += velocity
            heights.append(height)
        if pushes == stretch - 1:  # Gymnasium draws the next one here, at the last corner too.
            stretch = int(rng.integers(*stretches))
    return heights


class _Recorder:
    """Takes the place of the world while gymnasium's class draws a terrain: keeps obstacles."""

    def __init__(self) -> None:
        self.obstacles: list[Sequence[tuple[float, float]]] = []

    def CreateStaticBody(self, fixtures: Any) -> Any:
        """Keeps a shape that is no edge; gymnasium colours what it gets back."""
        vertices = tuple(fixtures.shape.vertices)
        if len(vertices) > 2:
            self.obstacles.append(vertices)
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
        self._parts = {int(part.this): part for part in (walker.hull, *walker.legs)}

    def BeginContact(self, contact: Any) -> None:
        """The hull ends the episode, a foot stands; of the others nobody asks."""
        part = self._part(contact)
        if part == self._hull:
            self._walker.game_over = True
        else:
            self._parts[part].ground_contact = True

    def EndContact(self, contact: Any) -> None:
        """A foot has left one of the things that it stood on."""
        self._parts[self._part(contact)].ground_contact = False

    def _part(self, contact: Any) -> int:
        """Address of the walker's body in a contact; the other body is the ground's.

        Between an edge and a polygon Box2D names the polygon last: a second look is rare.
        """
        body = int(contact.fixtureB.body.this)
        return body if body in self._parts else int(contact.fixtureA.body.this)

    # Box2D calls these for every contact at every step. Those of the base class do nothing either,
    # but only after a way back into Box2D.

    def PreSolve(self, contact: Any, before: Any) -> None:
        """Nothing is to be done before a contact is solved."""

    def PostSolve(self, contact: Any, impulse: Any) -> None:
        """Nor after it."""


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
        world = self.world
        assert world is not None
        if hardcore:
            self.world = _Recorder()
            super()._generate_terrain(hardcore)
            obstacles, self.world = self.world.obstacles, world
            for vertices in obstacles:
                self._polygon.shape.vertices = vertices
                world.CreateStaticBody(fixtures=self._polygon)
            self.only_edges = not obstacles
        else:
            self.terrain_x = [i * official.TERRAIN_STEP for i in range(official.TERRAIN_LENGTH)]
            self.terrain_y = _draw_grass(self.np_random)
            self.only_edges = True
        bodies = [world.CreateStaticBody() for _ in range(_BODIES)]
        corners = zip(self.terrain_x, self.terrain_y, strict=True)
        edge = self._edge.shape
        for place, (edge.vertex1, edge.vertex2) in enumerate(itertools.pairwise(corners)):
            bodies[place % _BODIES].CreateFixture(self._edge)

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
        # Past the end of the terrain are edges of no length, which no ray meets.
        edges = official.TERRAIN_LENGTH - 1 + _WINDOW
        self._columns = np.zeros((7, edges, num_walkers), np.float32)

    def set(self, walker: int, x: Sequence[float], y: Sequence[float]) -> None:
        """Takes the terrain of a walker: the corners of its edges."""
        corner = np.array([x, y], np.float32)
        start, along = corner[:, :-1], np.diff(corner)
        squares = along * along
        length = np.sqrt(squares[0] + squares[1])
        inverse = np.float32(1.0) / length
        normal = np.stack([along[1] * inverse, -along[0] * inverse])
        columns = *start, *normal, *along, squares[0] + squares[1]
        self._columns[:, : start.shape[1], walker] = columns

    def fractions(self, walkers: np.ndarray, place: np.ndarray) -> np.ndarray:
        """How far each ray gets, as a fraction of its length.

        Args:
            walkers: whose terrains, int [M].
            place: of their hulls, float64 [2, M]; the values of float32 numbers.

        Returns:
            Fractions, 1 where a ray meets nothing, float32 [M, 10].
        """
        first = np.floor(place[0] / official.TERRAIN_STEP).astype(np.int64) - 1
        first = np.clip(first, 0, self._columns.shape[1] - _WINDOW)
        edges = self._columns[:, first + np.arange(_WINDOW)[:, None], walkers]  # [7, window, M]
        here = place.astype(np.float32)[:, None]
        apart = edges[2:4] * (edges[0:2] - here)
        above = (apart[0] + apart[1]).take(_PAIR_EDGE, axis=0)  # [P, M]
        edges = edges.take(_PAIR_EDGE, axis=1)  # [7, P, M]
        start, normal, along, square = edges[0:2], edges[2:4], edges[4:6], edges[6]
        ray = (place[:, None] + _REACH[:, :, None]).astype(np.float32) - here
        ray = ray.take(_PAIR_RAY, axis=1)  # [2, P, M]
        with np.errstate(divide="ignore", invalid="ignore"):
            toward = normal * ray
            fraction = above / (toward[0] + toward[1])
            offset = (here + fraction * ray - start) * along
            share = (offset[0] + offset[1]) / square
            # A ray along an edge gives what is not a number, and no hit.
            met = (fraction >= 0) & (fraction <= 1) & (share >= 0) & (share <= 1)
        np.copyto(fraction, np.float32(1.0), where=~met)
        return np.minimum.reduceat(fraction, _FIRST_PAIR, axis=0).T


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
            env_id: one of `OUR_WALKERS`.
            num_walkers: of this process.
        """
        spec = gymnasium.spec(env_id)
        assert spec.max_episode_steps is not None
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

    def terrain(self, index: int) -> tuple[list[float], list[float]]:
        """Corners of a walker's ground: places along it and heights [m]."""
        walker = self._walkers[index]
        return list(walker.terrain_x), list(walker.terrain_y)

    def bodies(self, index: int) -> list[tuple[float, float, float]]:
        """Place [m] and angle [rad] of a walker's hull, thigh, shin, thigh and shin."""
        walker = self._walkers[index]
        return [(*body.position, body.angle) for body in (walker.hull, *walker.legs)]

    def _answer(
        self, arrays: SharedArrays, played: np.ndarray, stepped: np.ndarray, strength: np.ndarray
    ) -> None:
        """Observation, reward and end of the walkers that played; the sums are gymnasium's own."""
        raw = np.array([self._walkers[index].read() for index in played.tolist()]).T
        # A view of all walkers is read and written faster than a choice of them.
        rows = slice(None) if played.size == len(self._walkers) else played
        place, over = raw[14:16], raw[16] > 0
        arrays.observation[rows, :14] = _proprioception(raw).T
        arrays.observation[rows, 14:] = self._lidar(played, place)
        shaping = 130 * place[0] / official.SCALE - 5.0 * np.abs(raw[0])
        reward = (shaping - self._shaping[rows]).astype(np.float32)
        for effort in (np.float32(0.00035 * official.MOTORS_TORQUE) * strength).T:
            reward -= effort
        fallen = over | (place[0] < 0)
        reward[fallen] = -100
        self._shaping[rows] = shaping
        self._steps[rows] += stepped
        arrays.reward[rows] = np.where(stepped, reward, 0)
        arrays.terminated[rows] = stepped & (fallen | (place[0] > _GOAL))
        arrays.truncated[rows] = stepped & (self._steps[rows] >= self._limit)

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
    state[5:11:5] /= official.SPEED_HIP
    state[6:12:5] += 1.0
    state[7:13:5] /= official.SPEED_KNEE
    return state
