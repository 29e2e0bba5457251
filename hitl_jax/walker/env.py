"""BipedalWalker-v3 as pure functions of one walker; `vmap` them over as many as you like."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import bipedal, constants, terrain
from hitl_jax.walker.batching.batch_last_vmap import of_one
from hitl_jax.walker.geometry import Vec, pose, vec
from hitl_jax.walker.physics import ground, joints, manifolds, world
from hitl_jax.walker.physics.joints import Impulses
from hitl_jax.walker.physics.world import World
from hitl_jax.walker.terrain import Terrain

OBSERVATION_SIZE = 24
ACTION_SIZE = 4
MOST_STEPS, MOST_HARDCORE_STEPS = bipedal.MOST_STEPS, bipedal.MOST_HARDCORE_STEPS
_EFFORT = 0.00035 * bipedal.MOTORS_TORQUE


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Walker:
    """A walker in the middle of an episode.

    Attributes:
        world: its bodies; see `World`, without the last axis.
        terrain: its ground.
        shaping: the potential whose growth is the reward.
        steps: made so far, -1 before the one that ends the reset, int32.
    """

    world: World
    terrain: Terrain
    shaping: jax.Array
    steps: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Step:
    """What came of a step; `terminated` and `truncated` can both be true.

    Attributes:
        observation: [24].
        reward: of the step.
        terminated: whether the walker fell or reached the end, bool.
        truncated: whether the step was the last that an episode may have, bool.
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
    walker, first = step(made(key, hardcore), jnp.zeros(ACTION_SIZE, jnp.float32))
    return walker, first.observation


def made(key: jax.Array, hardcore: bool = False) -> Walker:
    """A walker as gymnasium's reset makes it, before the step without motors that ends the reset.

    Args:
        key: consumed.
        hardcore: static; see `reset`.

    Returns:
        The walker; `step` it with an action of zeros.
    """
    ground_key, push_key = jax.random.split(key)
    most = bipedal.INITIAL_RANDOM
    push = jax.random.uniform(push_key, (), jnp.float32, -most, most)
    return made_on(terrain.drawn(ground_key, hardcore), push)


def made_on(ground: Terrain, push: jax.Array) -> Walker:
    """A walker on given terrain; see `made`.

    Args:
        ground: the terrain.
        push: that the hull gets in the first step [N].

    Returns:
        The walker.
    """
    return Walker(_bodies(push), ground, jnp.float32(0.0), jnp.int32(-1))


def _bodies(push: jax.Array) -> World:
    """The bodies as gymnasium makes them; its hinges pull them together in the first steps."""
    x, y = bipedal.START_X, bipedal.START_Y
    thigh = y - bipedal.LEG_H / 2 - bipedal.LEG_DOWN
    shin = y - bipedal.LEG_H * 3 / 2 - bipedal.LEG_DOWN
    hull = np.array([x, y]) + constants.HULL_CENTRE
    zero = jnp.zeros(5, jnp.float32)
    hinge = jnp.zeros(4, jnp.float32)
    pushed = push * np.float32(constants.SECONDS * constants.INVERSE_MASS[0])
    return World(
        place=Vec(
            jnp.asarray([hull[0], x, x, x, x], jnp.float32),
            jnp.asarray([hull[1], thigh, shin, thigh, shin], jnp.float32),
        ),
        angle=jnp.asarray([0.0, *constants.START_TILTS], jnp.float32),
        velocity=Vec(zero.at[0].set(pushed), zero),
        spin=zero,
        impulses=Impulses(Vec(hinge, hinge), hinge, hinge),
        contacts=jax.tree.map(lambda leaf: leaf[..., 0], manifolds.no_contacts(1)),
        feet=jnp.zeros(4, bool),
        fallen=jnp.zeros((), bool),
    )


def _advance(
    before: World, action: jax.Array, terrain: Terrain
) -> tuple[World, jax.Array, jax.Array]:
    """The world after a step, the observation and the place of the hull; last axis is the batch."""
    speed = jnp.asarray(constants.SPEEDS[:, None], jnp.float32) * jnp.sign(action)
    torque = constants.TORQUE * jnp.clip(jnp.abs(action), 0, 1)
    after = world.step(before, speed, torque, terrain)
    observation, place = observe(after, terrain)
    return after, observation, place


def observe(now: World, terrain: Terrain) -> tuple[jax.Array, jax.Array]:
    """What a walker sees; the last axis is the batch.

    Args:
        now: the world.
        terrain: the ground, leaves [200, B].

    Returns:
        Observations [24, B], and how far the hull has come [B] [m].
    """
    angle, spin = now.angle[0], now.spin[0]
    body = pose(Vec(now.place.x[0], now.place.y[0]), angle)
    origin = body.put(vec(-constants.HULL_CENTRE))
    fps, scale = bipedal.FPS, bipedal.SCALE
    bend, speed = joints.angles(now.angle), joints.speeds(now.spin)
    feet = now.feet.astype(jnp.float32)
    legs = [
        row
        for leg in range(2)
        for row in (
            bend[2 * leg],
            speed[2 * leg] / bipedal.SPEED_HIP,
            bend[2 * leg + 1] + 1.0,
            speed[2 * leg + 1] / bipedal.SPEED_KNEE,
            feet[2 * leg + 1],
        )
    ]
    seen = [
        angle,
        2.0 * spin / fps,
        0.3 * now.velocity.x[0] * (bipedal.VIEWPORT_W / scale) / fps,
        0.3 * now.velocity.y[0] * (bipedal.VIEWPORT_H / scale) / fps,
        *legs,
    ]
    return jnp.concatenate([jnp.stack(seen), ground.lidar(terrain, origin)]), origin.x


_advance_one = of_one(_advance)


def step(walker: Walker, action: jax.Array) -> tuple[Walker, Step]:
    """One step of 0.02 s.

    Args:
        walker: before it.
        action: of hip and knee, hip and knee [4]; beyond [-1, 1] it is clipped.

    Returns:
        The walker after it, and what came of it. After the end of an episode it means nothing.
    """
    action = jnp.asarray(action, jnp.float32)
    after, observation, place = _advance_one(walker.world, action, walker.terrain)
    shaping = 130 * place / bipedal.SCALE - 5.0 * jnp.abs(observation[0])
    effort = (_EFFORT * jnp.clip(jnp.abs(action), 0, 1)).sum()
    fallen = after.fallen | (place < 0)
    reward = jnp.where(fallen, -100.0, shaping - walker.shaping - effort)
    steps = walker.steps + 1
    most = MOST_STEPS if walker.terrain.boxes is None else MOST_HARDCORE_STEPS
    made = Step(observation, reward, fallen | (place > constants.GOAL), steps >= most)
    return Walker(after, walker.terrain, shaping, steps), made
