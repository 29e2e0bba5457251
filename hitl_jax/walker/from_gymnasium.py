"""Copies the state of gymnasium's walker, to compare with it or to continue from it."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import constants
from hitl_jax.walker.geometry import vec
from hitl_jax.walker.physics.boxes import Boxes
from hitl_jax.walker.physics.contacts import Contacts
from hitl_jax.walker.physics.joints import JointImpulses
from hitl_jax.walker.physics.manifolds import FACE, FIRST_BOX, SLOTS
from hitl_jax.walker.physics.world import World
from hitl_jax.walker.terrain import Terrain


def terrain_of(env: Any) -> Terrain:
    """The terrain of a walker.

    Args:
        env: gymnasium's `BipedalWalker`, after its reset.

    Returns:
        The terrain, leaves [TERRAIN_LENGTH].
    """
    heights = jnp.asarray(np.array(env.terrain_y, np.float32))
    if not env.hardcore:
        return Terrain(heights)
    low, high = np.zeros((2, constants.TERRAIN_LENGTH, 2), np.float32)
    for body in env.terrain:
        corners = np.array(body.fixtures[0].shape.vertices, np.float32)
        if len(corners) == 4:
            begin, end = np.rint(corners[:, 0] / constants.TERRAIN_STEP).astype(int)[[2, 0]]
            low[begin:end], high[begin:end] = corners.min(0), corners.max(0)
    return Terrain(heights, Boxes(vec(low), vec(high)))


def world_of(env: Any) -> World:
    """The state of a walker's bodies, joints and contacts, with their impulses.

    Args:
        env: gymnasium's `BipedalWalker`, after its reset.

    Returns:
        The world of a batch of one: the last axis is 1.
    """
    bodies = [env.hull, *env.legs]
    world_centres = np.array([tuple(body.worldCenter) for body in bodies], np.float32)
    velocities = np.array([tuple(body.linearVelocity) for body in bodies], np.float32)
    angles = np.array([body.angle for body in bodies], np.float32)[:, None]
    place = vec(world_centres, 1)
    return World(
        place=place,
        angle=jnp.asarray(angles),
        velocity=vec(velocities, 1),
        spin=jnp.asarray(np.array([body.angularVelocity for body in bodies], np.float32)[:, None]),
        impulses=_impulses(env),
        contacts=_contacts(env),
        ground_contact=jnp.asarray(
            [[bool(getattr(leg, "ground_contact", False))] for leg in env.legs]
        ),
        fallen=jnp.asarray([bool(env.game_over)]),
    )


def _impulses(env: Any) -> JointImpulses:
    """The joints' impulses [4, 1]; Box2D gives them as forces over one second."""
    forces = np.array([tuple(joint.GetReactionForce(1.0)) for joint in env.joints], np.float32)
    limits = np.array([joint.GetReactionTorque(1.0) for joint in env.joints], np.float32)
    motors = np.array([joint.GetMotorTorque(1.0) for joint in env.joints], np.float32)
    return JointImpulses(
        vec(forces, 1),
        jnp.asarray(limits[:, None]),
        jnp.asarray(motors[:, None]),
    )


def _contacts(env: Any) -> Contacts:
    """The contacts of the legs' parts, in Box2D's order [4, 4, 1]."""
    shape = (SLOTS, len(env.legs), 1)
    edge = np.full(shape, -1, np.int32)
    keys, valid = np.zeros((2, *shape), np.int32), np.zeros((2, *shape), bool)
    normal, friction = (np.zeros((2, *shape), np.float32) for _ in range(2))
    for part, leg in enumerate(env.legs):
        touching = [entry.contact for entry in leg.contacts if entry.contact.touching]
        for slot, contact in enumerate(touching[:SLOTS]):
            is_second = contact.fixtureA.body == leg
            ground = contact.fixtureB if is_second else contact.fixtureA
            corners = ground.shape.vertices
            column = round(min(x for x, _ in corners) / constants.TERRAIN_STEP)
            edge[slot, part] = column + (FIRST_BOX if len(corners) == 4 else 0)
            for row, point in enumerate(contact.manifold.points[: contact.manifold.pointCount]):
                place = (row, slot, part)
                keys[place] = _key(point.id.cf, is_second)
                valid[place] = True
                normal[place] = point.normalImpulse
                friction[place] = point.tangentImpulse
    pairs = [
        tuple(jnp.asarray(rows) for rows in array) for array in (keys, valid, normal, friction)
    ]
    return Contacts(jnp.asarray(edge), *pairs)  # type: ignore[arg-type]


def _key(feature: Any, ground_is_second: bool) -> int:
    """Our key of Box2D's contact feature; see `Manifold.keys`."""
    ground, part, kind = feature.indexA, feature.indexB, feature.typeA
    if ground_is_second:
        ground, part, kind = part, ground, feature.typeB
    return int(ground + 8 * part + FACE * kind)
