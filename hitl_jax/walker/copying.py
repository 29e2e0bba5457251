"""Copies the state of gymnasium's walker, to compare with it or to go on from there."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import ground, parts, touch
from hitl_jax.walker.hinges import Impulses
from hitl_jax.walker.plane import pose, vec
from hitl_jax.walker.world import World, legs_left, legs_of


def heights_of(env: Any) -> np.ndarray:
    """Heights of the corners of a walker's plain terrain.

    Args:
        env: gymnasium's `BipedalWalker`, after its reset.

    Returns:
        Heights, float32 [TERRAIN_LENGTH] [m].
    """
    return np.array(env.terrain_y, np.float32)


def world_of(env: Any) -> World:
    """The state of a walker, impulses included.

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
    heights = jnp.asarray(heights_of(env))[:, None]
    edges = ground.edges_of_parts(heights, legs_left(legs_of(pose(place, jnp.asarray(angles)))))
    return World(
        place=place,
        angle=jnp.asarray(angles),
        velocity=vec(velocities, 1),
        spin=jnp.asarray(np.array([body.angularVelocity for body in bodies], np.float32)[:, None]),
        impulses=_impulses(env),
        contacts=_contacts(env, np.asarray(edges.index)),
        feet=jnp.asarray([[bool(getattr(leg, "ground_contact", False))] for leg in env.legs]),
        fallen=jnp.asarray([bool(env.game_over)]),
    )


def _impulses(env: Any) -> Impulses:
    forces = np.array([tuple(joint.GetReactionForce(1.0)) for joint in env.joints], np.float32)
    limits = np.array([joint.GetReactionTorque(1.0) for joint in env.joints], np.float32)
    motors = np.array([joint.GetMotorTorque(1.0) for joint in env.joints], np.float32)
    return Impulses(
        vec(forces, 1),
        jnp.asarray(limits[:, None]),
        jnp.asarray(motors[:, None]),
    )


def _contacts(env: Any, index: np.ndarray) -> touch.Contacts:
    """Contacts by slot; the index is that of the edge in each [4, 4, 1]."""
    keys = np.zeros((2, 4, 4, 1), np.int32)
    valid = np.zeros((2, 4, 4, 1), bool)
    normal, along = (np.zeros((2, 4, 4, 1), np.float32) for _ in range(2))
    for part, leg in enumerate(env.legs):
        for entry in leg.contacts:
            contact = entry.contact
            if not contact.touching:
                continue
            corner = contact.fixtureA.shape.vertices[0][0]
            edge = round(corner / parts.TERRAIN_STEP)
            slot = int(index[0, part, 0]) - edge
            if not 0 <= slot < index.shape[0]:
                continue
            for row, point in enumerate(contact.manifold.points[: contact.manifold.pointCount]):
                feature = point.id.cf
                place = (row, slot, part, 0)
                keys[place] = feature.indexA + 8 * feature.indexB + touch.FACE * feature.typeA
                valid[place] = True
                normal[place] = point.normalImpulse
                along[place] = point.tangentImpulse
    pairs = [tuple(jnp.asarray(rows) for rows in array) for array in (keys, valid, normal, along)]
    return touch.Contacts(jnp.asarray(index), *pairs)  # type: ignore[arg-type]
