"""Gymnasium's bipedal walker in Box2D's own world: built from our constants, stepped and read.

Every bit of an episode is as in gymnasium's class. For speed some things are done differently:

- The edges of the terrain share a few static bodies instead of having one each: the solver visits
  every body at each step.
- The world is dropped whole at a reset, not body by body; clouds' random numbers are drawn, but no
  clouds are built.
- The contact listener finds a body by its address, not by comparing proxies, and answers Box2D's
  calls before and after solving a contact at once.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

from hitl_jax.envs import box2d
from hitl_jax.envs.lean_lidar import CORNER_X
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

_BODIES = 20
"""Static bodies that the edges share in turn. Box2D does not treat contacts with one body as
independent; edges of one body are so far apart (9 m) that a walker (at most 5 m) touches one of
them at a time."""

_GROUND, _WALKER = 0x0001, 0x0020
"""Collision categories: parts of the walker collide with the ground, not with each other."""


def _part_fixture(shape: Any, density: float, friction: float) -> Any:
    """Box2D's fixture of a part of the walker."""
    return b2FixtureDef(
        shape=shape,
        density=density,
        friction=friction,
        restitution=0.0,
        categoryBits=_WALKER,
        maskBits=_GROUND,
    )


def _leg_fixture(width: float) -> Any:
    """The fixture of a thigh or a shin."""
    shape = b2PolygonShape(box=(width / 2, bipedal.LEG_H / 2))
    return _part_fixture(shape, bipedal.LEG_DENSITY, bipedal.LEG_FRICTION)


def _ground_fixture(shape: Any) -> Any:
    """The fixture of an edge or an obstacle."""
    return b2FixtureDef(shape=shape, friction=bipedal.GROUND_FRICTION, categoryBits=_GROUND)


_HULL = _part_fixture(
    b2PolygonShape(vertices=[(x / bipedal.SCALE, y / bipedal.SCALE) for x, y in bipedal.HULL_POLY]),
    bipedal.HULL_DENSITY,
    bipedal.HULL_FRICTION,
)
_THIGH, _SHIN = _leg_fixture(bipedal.LEG_W), _leg_fixture(bipedal.SHIN_W)


class _GroundContacts(b2ContactListener):
    """Keeps each part's ground contact, as gymnasium's listener does."""

    def __init__(self, hull: Any, legs: Sequence[Any]):
        super().__init__()
        self._hull = int(hull.this)
        self.fallen = False
        self.ground_contact = dict.fromkeys((int(part.this) for part in (hull, *legs)), False)

    def BeginContact(self, contact: Any) -> None:
        """Sets the part's ground contact; that of the hull ends the episode."""
        part = self._part(contact)
        if part == self._hull:
            self.fallen = True
        self.ground_contact[part] = True

    def EndContact(self, contact: Any) -> None:
        """Clears the part's ground contact, also while it still touches another edge."""
        self.ground_contact[self._part(contact)] = False

    def _part(self, contact: Any) -> int:
        """Address of the walker's body in a contact; the other body is the ground's.

        Box2D puts the polygon second in a contact with an edge, so fixture A is rarely read.
        """
        body = int(contact.fixtureB.body.this)
        return body if body in self.ground_contact else int(contact.fixtureA.body.this)

    # Box2D calls these for every contact at every step. The base class's also do nothing, but they
    # take a call back into Box2D.

    def PreSolve(self, contact: Any, before: Any) -> None:
        """Does nothing before a contact is solved."""

    def PostSolve(self, contact: Any, impulse: Any) -> None:
        """Does nothing after a contact is solved."""


class _LidarRay(b2RayCastCallback):
    """A lidar ray; Box2D reports what it hits in any order."""

    fraction = 1.0

    def ReportFixture(self, fixture: Any, point: Any, normal: Any, fraction: float) -> float:
        """Cuts the ray where it hits the ground; the walker's own parts are ignored."""
        if not fixture.filterData.categoryBits & _GROUND:
            return -1
        self.fraction = fraction
        return fraction


class Box2dWalker:
    """One walker in a Box2D world of its own.

    Attributes:
        hull: Box2D's body of the hull.
        legs: Box2D's bodies: thigh and shin of one leg, of the other.
        joints: Box2D's joints: hip and knee of one leg, of the other.
        contacts: which parts touch the ground.
        is_plain: whether the ground has no obstacles.
        heights: of the ground's corners [TERRAIN_LENGTH] [m].
    """

    def __init__(self, hardcore: bool):
        """Waits for `start`.

        Args:
            hardcore: whether the terrain has stumps, stairs and pits.
        """
        self._hardcore = hardcore
        self._edge = _ground_fixture(b2EdgeShape(vertices=[(0, 0), (1, 1)]))
        self._polygon = _ground_fixture(b2PolygonShape(box=(1, 1)))
        self._rays = [_LidarRay() for _ in bipedal.LIDAR_REACH]
        self.heights: list[float] = []
        self.is_plain = False

    def start(self, seed: int) -> None:
        """Begins a seed's episode in a new world, with the step that ends gymnasium's reset."""
        drawn = bipedal.draw_start(bipedal.random_numbers(seed), self._hardcore)
        self._world = b2World()
        self._build_ground(drawn.heights, drawn.boxes)
        self._build_body()
        self.hull.ApplyForceToCenter((drawn.push, 0), True)
        # The world keeps no reference to its listener: it would be garbage collected.
        self.contacts = _GroundContacts(self.hull, self.legs)
        self._world.contactListener = self.contacts
        self._feet = [int(shin.this) for shin in self.legs[1::2]]
        self.step([0.0] * 4, [0.0] * 4)

    def _build_ground(self, heights: list[float], boxes: list[bipedal.Box]) -> None:
        """Adds obstacles, then edges, in gymnasium's order."""
        self.heights, self.is_plain = heights, not boxes
        world, polygon = self._world, self._polygon.shape
        for left, bottom, right, top in boxes:
            polygon.vertices = [(left, bottom), (right, bottom), (right, top), (left, top)]
            world.CreateStaticBody(fixtures=self._polygon)
        bodies = [world.CreateStaticBody() for _ in range(_BODIES)]
        corners = zip(CORNER_X, heights, strict=True)
        edge = self._edge.shape
        for place, (edge.vertex1, edge.vertex2) in enumerate(itertools.pairwise(corners)):
            bodies[place % _BODIES].CreateFixture(self._edge)

    def _build_body(self) -> None:
        """Adds hull, legs and joints, in gymnasium's order."""
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

    def step(self, speeds: list[float], torques: list[float]) -> None:
        """Sets the motors and steps the world.

        Args:
            speeds: target speeds of the joints' motors [4] [rad/s].
            torques: the most torque of each motor [4] [N m].
        """
        for joint, speed, torque in zip(self.joints, speeds, torques, strict=True):
            joint.motorSpeed = speed
            joint.maxMotorTorque = torque
        self._world.Step(bipedal.SECONDS, bipedal.VELOCITY_ITERATIONS, bipedal.POSITION_ITERATIONS)

    def read(self) -> tuple[float, ...]:
        """The numbers of the state from which observation and reward follow, in this order."""
        hull, ground_contact = self.hull, self.contacts.ground_contact
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
            ground_contact[foot],
            other_hip.angle,
            other_hip.speed,
            other_knee.angle,
            other_knee.speed,
            ground_contact[other_foot],
            place.x,
            place.y,
            self.contacts.fallen,
        )

    def lidar(self) -> Iterator[float]:
        """The fractions of the ten rays, by Box2D's ray cast."""
        place = self.hull.position
        for ray, (x, y) in zip(self._rays, bipedal.LIDAR_REACH, strict=True):
            ray.fraction = 1.0
            self._world.RayCast(ray, place, (place.x + x, place.y + y))
            yield ray.fraction
