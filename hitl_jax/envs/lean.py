"""Gymnasium's bipedal walker on Box2D, the same numbers in half the time.

Body, terrain and rewards are built from `hitl_jax.walker.bipedal`; the world and its solver are
Box2D's own. What is done otherwise than in gymnasium's class leaves every bit of an episode as it
is there:

- The edges of the terrain share a few static bodies instead of having one each: the solver visits
  every body at each step.
- Lidar over plain terrain is computed here, in Box2D's own order of float32 operations, for all
  walkers of a process at once; through Box2D each ray calls back into Python.
- Observations and rewards are computed for all walkers at once.
- The world is dropped whole at a reset, not body by body; clouds are drawn from the generator, not
  built.
- Who touches the ground is told by the address of a body, not by comparing proxies, and what
  Box2D says of every contact before and after solving it is answered at once.
"""

import itertools
import platform
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hitl_jax.envs import HARDCORE_WALKER, box2d
from hitl_jax.envs.base import Command
from hitl_jax.envs.shared import SharedArrays
from hitl_jax.walker import bipedal

with box2d.quiet():
    from Box2D import (  # type: ignore[import-untyped]
        b2ContactListener,
        b2EdgeShape,
        b2FixtureDef,
        b2PolygonShape,
        b2RayCastCallback,
        b2RevoluteJointDef,
        b2World,
    )

_REACH = np.array(bipedal.LIDAR_REACH).T
_SPANS = np.ceil(_REACH[0] / bipedal.TERRAIN_STEP).astype(int) + 3
"""Edges that each ray may meet, with one to spare on either side."""

_WINDOW = int(_SPANS.max())
_FIRST_PAIR = np.cumsum(_SPANS) - _SPANS
_PAIR_RAY = np.repeat(np.arange(len(_SPANS)), _SPANS)
_PAIR_EDGE = np.arange(_SPANS.sum()) - _FIRST_PAIR[_PAIR_RAY]
"""Of every ray with each edge that it may meet, P pairs: the ray, and the edge in the window."""

_BODIES = 20
"""Bodies that the edges share in turn. Contacts with one body are not independent of each other in
Box2D; edges of one body are so far apart (9 m) that a walker (at most 5 m) meets one at a time."""

# Elsewhere the compiler of Box2D may have fused a product and a sum, which rounds differently.
_ROUNDS_ALIKE = platform.machine().lower() in ("x86_64", "amd64")

_SPEEDS = np.array([bipedal.SPEED_HIP, bipedal.SPEED_KNEE] * 2, np.float32)

_PLACES = [corner * bipedal.TERRAIN_STEP for corner in range(bipedal.TERRAIN_LENGTH)]
"""Of the ground's corners [m]."""

_GROUND, _WALKER = 0x0001, 0x0020
"""Box2D's categories of bodies; the walker's parts meet the ground alone."""


def _part(shape: Any, density: float, friction: float) -> Any:
    """What Box2D makes a part of the walker of."""
    return b2FixtureDef(
        shape=shape,
        density=density,
        friction=friction,
        restitution=0.0,
        categoryBits=_WALKER,
        maskBits=_GROUND,
    )


def _leg_part(width: float) -> Any:
    shape = b2PolygonShape(box=(width / 2, bipedal.LEG_H / 2))
    return _part(shape, bipedal.LEG_DENSITY, bipedal.LEG_FRICTION)


def _ground(shape: Any) -> Any:
    return b2FixtureDef(shape=shape, friction=bipedal.GROUND_FRICTION, categoryBits=_GROUND)


_HULL = _part(
    b2PolygonShape(vertices=[(x / bipedal.SCALE, y / bipedal.SCALE) for x, y in bipedal.HULL_POLY]),
    bipedal.HULL_DENSITY,
    bipedal.HULL_FRICTION,
)
_THIGH, _SHIN = _leg_part(bipedal.LEG_W), _leg_part(bipedal.SHIN_W)


class _Contacts(b2ContactListener):
    """Notes on a walker's parts whether they touch the ground, as gymnasium's listener does."""

    def __init__(self, hull: Any, legs: Sequence[Any]):
        super().__init__()
        self._hull = int(hull.this)
        self.fallen = False
        self.stands = dict.fromkeys((int(part.this) for part in (hull, *legs)), False)

    def BeginContact(self, contact: Any) -> None:
        """The hull ends the episode, a foot stands; of the others nobody asks."""
        part = self._part(contact)
        if part == self._hull:
            self.fallen = True
        self.stands[part] = True

    def EndContact(self, contact: Any) -> None:
        """A foot has left one of the things that it stood on."""
        self.stands[self._part(contact)] = False

    def _part(self, contact: Any) -> int:
        """Address of the walker's body in a contact; the other body is the ground's.

        Between an edge and a polygon Box2D names the polygon last: a second look is rare.
        """
        body = int(contact.fixtureB.body.this)
        return body if body in self.stands else int(contact.fixtureA.body.this)

    # Box2D calls these for every contact at every step. Those of the base class do nothing either,
    # but only after a way back into Box2D.

    def PreSolve(self, contact: Any, before: Any) -> None:
        """Nothing is to be done before a contact is solved."""

    def PostSolve(self, contact: Any, impulse: Any) -> None:
        """Nor after it."""


class _Lidar(b2RayCastCallback):
    """How far a ray got: what it meets comes in any order."""

    fraction = 1.0

    def ReportFixture(self, fixture: Any, point: Any, normal: Any, fraction: float) -> float:
        """Cuts the ray where it meets the ground; the walker's own parts do not count."""
        if not fixture.filterData.categoryBits & _GROUND:
            return -1
        self.fraction = fraction
        return fraction


class _Walker:
    """One walker, its terrain on few bodies; advanced and read from outside.

    Attributes:
        hull: its body in Box2D.
        legs: thigh and shin of one leg, of the other.
        joints: hip and knee of one leg, of the other.
        contacts: what touches the ground.
        only_edges: whether the ground is without obstacles.
        heights: of its corners [m].
    """

    def __init__(self, hardcore: bool):
        self._hardcore = hardcore
        self._edge = _ground(b2EdgeShape(vertices=[(0, 0), (1, 1)]))
        self._polygon = _ground(b2PolygonShape(box=(1, 1)))
        self._lidar = [_Lidar() for _ in bipedal.LIDAR_REACH]
        self.heights: list[float] = []
        self.only_edges = False

    def start(self, seed: int) -> None:
        """Begins the episode of a seed in a new world, and makes the step that ends a reset."""
        drawn = bipedal.draw_start(bipedal.random_numbers(seed), self._hardcore)
        self._world = b2World()
        self._build_ground(drawn.heights, drawn.boxes)
        self._build_body()
        self.hull.ApplyForceToCenter((drawn.push, 0), True)
        # The world keeps no reference of its own to its listener.
        self.contacts = _Contacts(self.hull, self.legs)
        self._world.contactListener = self.contacts
        self._feet = [int(shin.this) for shin in self.legs[1::2]]
        self.advance([0.0] * 4, [0.0] * 4)

    def _build_ground(self, heights: list[float], boxes: list[bipedal.Box]) -> None:
        self.heights, self.only_edges = heights, not boxes
        world, polygon = self._world, self._polygon.shape
        for left, bottom, right, top in boxes:
            polygon.vertices = [(left, bottom), (right, bottom), (right, top), (left, top)]
            world.CreateStaticBody(fixtures=self._polygon)
        bodies = [world.CreateStaticBody() for _ in range(_BODIES)]
        corners = zip(_PLACES, heights, strict=True)
        edge = self._edge.shape
        for place, (edge.vertex1, edge.vertex2) in enumerate(itertools.pairwise(corners)):
            bodies[place % _BODIES].CreateFixture(self._edge)

    def _build_body(self) -> None:
        x, y, height = bipedal.START_X, bipedal.START_Y, bipedal.LEG_H
        hip, top, bottom = (0, bipedal.LEG_DOWN), (0, height / 2), (0, -height / 2)
        world = self._world
        self.hull = world.CreateDynamicBody(position=(x, y), fixtures=_HULL)
        self.legs, self.joints = [], []
        for side in bipedal.SIDES:
            above, anchor = self.hull, hip
            for part, middle, limits in (
                (_THIGH, height / 2, bipedal.HIP_LIMITS),
                (_SHIN, height * 3 / 2, bipedal.KNEE_LIMITS),
            ):
                leg = world.CreateDynamicBody(
                    position=(x, y - middle - bipedal.LEG_DOWN),
                    angle=side * bipedal.LEG_TILT,
                    fixtures=part,
                )
                joint = b2RevoluteJointDef(
                    bodyA=above,
                    bodyB=leg,
                    localAnchorA=anchor,
                    localAnchorB=top,
                    enableMotor=True,
                    enableLimit=True,
                    lowerAngle=limits[0],
                    upperAngle=limits[1],
                )
                self.legs.append(leg)
                self.joints.append(world.CreateJoint(joint))
                above, anchor = leg, bottom

    def advance(self, speeds: list[float], torques: list[float]) -> None:
        """Sets the motors and steps the world."""
        for joint, speed, torque in zip(self.joints, speeds, torques, strict=True):
            joint.motorSpeed = speed
            joint.maxMotorTorque = torque
        self._world.Step(bipedal.SECONDS, bipedal.VELOCITY_ITERATIONS, bipedal.POSITION_ITERATIONS)

    def read(self) -> tuple[float, ...]:
        """Place, velocity and angle of the hull, of the joints, contacts; see `_answer`."""
        hull, stands = self.hull, self.contacts.stands
        foot, other_foot = self._feet
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
            stands[foot],
            other_hip.angle,
            other_hip.speed,
            other_knee.angle,
            other_knee.speed,
            stands[other_foot],
            place.x,
            place.y,
            self.contacts.fallen,
        )

    def cast(self) -> Iterator[float]:
        """Box2D's own lidar."""
        place = self.hull.position
        for ray, (x, y) in zip(self._lidar, bipedal.LIDAR_REACH, strict=True):
            ray.fraction = 1.0
            self._world.RayCast(ray, place, (place.x + x, place.y + y))
            yield ray.fraction


class _Edges:
    """The edges of several plain terrains, and where rays meet them as Box2D computes it.

    All arithmetic is float32, one operation at a time, in the order of `b2EdgeShape::RayCast`. The
    result of Box2D's search over its tree is the least fraction of any edge, in whatever order it
    meets them.
    """

    def __init__(self, num_walkers: int):
        # Past the end of the terrain are edges of no length, which no ray meets.
        edges = bipedal.TERRAIN_LENGTH - 1 + _WINDOW
        self._columns = np.zeros((7, edges, num_walkers), np.float32)

    def set(self, walker: int, heights: Sequence[float]) -> None:
        """Takes the terrain of a walker: the heights of its corners [m]."""
        corner = np.array([_PLACES, heights], np.float32)
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
        first = np.floor(place[0] / bipedal.TERRAIN_STEP).astype(np.int64) - 1
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
        hardcore = env_id == HARDCORE_WALKER
        self._limit = bipedal.MOST_HARDCORE_STEPS if hardcore else bipedal.MOST_STEPS
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
                self._edges.set(index, walker.heights)
        strength = np.clip(np.abs(arrays.action), 0, 1)
        speeds = (_SPEEDS * np.sign(arrays.action)).tolist()
        torques = (bipedal.MOTORS_TORQUE * strength).tolist()
        for index in np.flatnonzero(stepped).tolist():
            self._walkers[index].advance(speeds[index], torques[index])
        played = np.flatnonzero(arrays.command != Command.IDLE)
        if played.size:
            self._answer(arrays, played, stepped[played], strength[played])

    def terrain(self, index: int) -> tuple[list[float], list[float]]:
        """Corners of a walker's ground: places along it and heights [m]."""
        return list(_PLACES), list(self._walkers[index].heights)

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
    state[1] = 2.0 * raw[1] / bipedal.FPS
    state[2] = 0.3 * raw[2] * (bipedal.VIEWPORT_W / bipedal.SCALE) / bipedal.FPS
    state[3] = 0.3 * raw[3] * (bipedal.VIEWPORT_H / bipedal.SCALE) / bipedal.FPS
    state[5:11:5] /= bipedal.SPEED_HIP
    state[6:12:5] += 1.0
    state[7:13:5] /= bipedal.SPEED_KNEE
    return state
