"""BipedalWalker-v3 as pure functions of one walker: `reset` and `step`; map them with `vmap`."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import bipedal, constants, terrain
from hitl_jax.walker.batching.batch_last_vmap import single_from_batch
from hitl_jax.walker.geometry import Vec, pose, vec
from hitl_jax.walker.physics import ground, joints, world
from hitl_jax.walker.physics.contacts import no_contacts
from hitl_jax.walker.physics.joints import JointImpulses
from hitl_jax.walker.physics.world import World
from hitl_jax.walker.terrain import Terrain

OBSERVATION_SIZE = 24
ACTION_SIZE = 4
MOST_STEPS, MOST_HARDCORE_STEPS = bipedal.MOST_STEPS, bipedal.MOST_HARDCORE_STEPS
_EFFORT = 0.00035 * bipedal.MOTORS_TORQUE
"""Cost of a motor at full torque in a step, part of the reward."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Walker:
    """A walker in the middle of an episode.

    Attributes:
        world: state of its bodies; see `World`, without the batch axis.
        terrain: the ground, leaves [TERRAIN_LENGTH].
        shaping: potential of the state; a step's reward is its growth minus the motors' cost.
        steps: number of steps so far, -1 before the one that ends the reset, int32.
    """

    world: World
    terrain: Terrain
    shaping: jax.Array
    steps: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Step:
    """The results of a step; `terminated` and `truncated` can both be true.

    Attributes:
        observation: s_{t+1}, float32 [24].
        reward: r(s, a), float32 [].
        terminated: whether the walker fell or reached the end of the terrain, bool [].
        truncated: whether the step reached the time limit, bool [].
    """

    observation: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array


def reset(key: jax.Array, hardcore: bool = False) -> tuple[Walker, jax.Array]:
    """Begins an episode on new terrain.

    Args:
        key: consumed.
        hardcore: static; whether the terrain has stumps, stairs and pits.

    Returns:
        The walker, and the first observation [24].
    """
    walker, first = step(new_walker(key, hardcore), jnp.zeros(ACTION_SIZE, jnp.float32))
    return walker, first.observation


def new_walker(key: jax.Array, hardcore: bool = False) -> Walker:
    """A walker on new terrain, before the step without motors that ends gymnasium's `reset`.

    Args:
        key: consumed.
        hardcore: static; see `reset`.

    Returns:
        The walker; `step` with an action of zeros gives the first observation.
    """
    ground_key, push_key = jax.random.split(key)
    most = bipedal.INITIAL_RANDOM
    push = jax.random.uniform(push_key, (), jnp.float32, -most, most)
    return new_walker_on(terrain.draw(ground_key, hardcore), push)


def new_walker_on(ground: Terrain, push: jax.Array) -> Walker:
    """A walker on given terrain; see `new_walker`.

    Args:
        ground: the terrain.
        push: horizontal force on the hull in the first step [N].

    Returns:
        The walker.
    """
    return Walker(_bodies(push), ground, jnp.float32(0.0), jnp.int32(-1))


def _bodies(push: jax.Array) -> World:
    """The bodies where gymnasium makes them; the joints pull them together in the first steps."""
    x, y = bipedal.START_X, bipedal.START_Y
    thigh = y - bipedal.LEG_H / 2 - bipedal.LEG_DOWN
    shin = y - bipedal.LEG_H * 3 / 2 - bipedal.LEG_DOWN
    hull = np.array([x, y]) + constants.HULL_CENTRE
    zero = jnp.zeros(5, jnp.float32)
    joint = jnp.zeros(4, jnp.float32)
    pushed = push * np.float32(constants.SECONDS * constants.INVERSE_MASS[0])
    return World(
        place=Vec(
            jnp.asarray([hull[0], x, x, x, x], jnp.float32),
            jnp.asarray([hull[1], thigh, shin, thigh, shin], jnp.float32),
        ),
        angle=jnp.asarray([0.0, *constants.START_TILTS], jnp.float32),
        velocity=Vec(zero.at[0].set(pushed), zero),
        spin=zero,
        impulses=JointImpulses(Vec(joint, joint), joint, joint),
        contacts=jax.tree.map(lambda leaf: leaf[..., 0], no_contacts(1)),
        ground_contact=jnp.zeros(4, bool),
        fallen=jnp.zeros((), bool),
    )


def _advance(
    before: World, action: jax.Array, terrain: Terrain
) -> tuple[World, jax.Array, jax.Array]:
    """State after a step, observation [24, B] and the hull's x [B], in m; the batch is last."""
    speed = jnp.asarray(constants.SPEEDS[:, None], jnp.float32) * jnp.sign(action)
    torque = constants.TORQUE * jnp.clip(jnp.abs(action), 0, 1)
    after = world.step(before, speed, torque, terrain)
    observation, place = observe(after, terrain)
    return after, observation, place


def observe(now: World, terrain: Terrain) -> tuple[jax.Array, jax.Array]:
    """The observation of walkers; the last axis is the batch.

    Args:
        now: their state.
        terrain: the ground, leaves [TERRAIN_LENGTH, B].

    Returns:
        Observations [24, B], and the hulls' x [B], in m.
    """
    angle, spin = now.angle[0], now.spin[0]
    body = pose(Vec(now.place.x[0], now.place.y[0]), angle)
    origin = body.world_point(vec(-constants.HULL_CENTRE))
    fps, scale = bipedal.FPS, bipedal.SCALE
    bend, speed = joints.angles(now.angle), joints.speeds(now.spin)
    ground_contact = now.ground_contact.astype(jnp.float32)
    legs = [
        row
        for leg in range(2)
        for row in (
            bend[2 * leg],
            speed[2 * leg] / bipedal.SPEED_HIP,
            bend[2 * leg + 1] + 1.0,
            speed[2 * leg + 1] / bipedal.SPEED_KNEE,
            ground_contact[2 * leg + 1],
        )
    ]
    rows = [
        angle,
        2.0 * spin / fps,
        0.3 * now.velocity.x[0] * (bipedal.VIEWPORT_W / scale) / fps,
        0.3 * now.velocity.y[0] * (bipedal.VIEWPORT_H / scale) / fps,
        *legs,
    ]
    return jnp.concatenate([jnp.stack(rows), ground.lidar(terrain, origin)]), origin.x


_advance_one = single_from_batch(_advance)


def step(walker: Walker, action: jax.Array) -> tuple[Walker, Step]:
    """One step of 0.02 s.

    Args:
        walker: state before the step.
        action: torques of hip and knee of one leg, of the other, clipped to [-1, 1], float32 [4].

    Returns:
        State after the step, and its results. They mean nothing after the end of an episode.
    """
    action = jnp.asarray(action, jnp.float32)
    after, observation, place = _advance_one(walker.world, action, walker.terrain)
    shaping = 130 * place / bipedal.SCALE - 5.0 * jnp.abs(observation[0])
    effort = (_EFFORT * jnp.clip(jnp.abs(action), 0, 1)).sum()
    fallen = after.fallen | (place < 0)
    reward = jnp.where(fallen, -100.0, shaping - walker.shaping - effort)
    steps = walker.steps + 1
    most = MOST_STEPS if walker.terrain.boxes is None else MOST_HARDCORE_STEPS
    results = Step(observation, reward, fallen | (place > constants.GOAL), steps >= most)
    return Walker(after, walker.terrain, shaping, steps), results
