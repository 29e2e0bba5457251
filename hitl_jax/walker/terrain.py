"""Terrain, drawn by key as gymnasium draws it (from other random numbers)."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import bipedal, constants
from hitl_jax.walker.batching.batch_last_vmap import of_one
from hitl_jax.walker.geometry import Vec
from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.walker.physics.boxes import Boxes

_STEP = np.float32(constants.TERRAIN_STEP)
_GRASS, _STUMP, _STAIRS, _PIT = range(4)
_STAIR_WIDTH, _PIT_DEPTH = 4, 4
"""In stretches of the ground between two corners."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Terrain:
    """The ground under one walker; within a step, the batch is a last axis.

    Attributes:
        heights: of its corners [TERRAIN_LENGTH] [m].
        boxes: what stands over the stretch from each corner to the next [TERRAIN_LENGTH]; None on
            plain terrain.
    """

    heights: jax.Array
    boxes: Boxes | None = None


def drawn(key: jax.Array, hardcore: bool = False) -> Terrain:
    """Terrain for an episode.

    Args:
        key: consumed.
        hardcore: static; whether it has stumps, stairs and pits.

    Returns:
        The terrain.
    """
    return rough(key) if hardcore else Terrain(grass(key))


def grass(key: jax.Array) -> jax.Array:
    """Plain terrain, drawn as gymnasium draws it (from other random numbers).

    A flat start, then stretches of 5 to 9 corners, the first of which repeats the height before.

    Args:
        key: consumed.

    Returns:
        Heights [TERRAIN_LENGTH] [m].
    """
    push_key, stretch_key = jax.random.split(key)
    shape = (constants.TERRAIN_LENGTH,)
    pushes = _uniform(push_key, shape) / np.float32(bipedal.SCALE)
    stretches = _whole(stretch_key, shape, bipedal.TERRAIN_GRASS // 2, bipedal.TERRAIN_GRASS)
    heights: jax.Array = _profile_of_one(pushes, stretches)
    return heights


def _profile(pushes: jax.Array, stretches: jax.Array) -> jax.Array:
    """Heights of the corners; arrays are [TERRAIN_LENGTH, B]."""
    start = bipedal.TERRAIN_HEIGHT

    def corner(carry: tuple, drawn: tuple) -> tuple:
        height, velocity, left, begins = carry
        index, push, stretch = drawn
        toward = 0.01 * jnp.sign(start - height)
        faster = 0.8 * velocity + toward + jnp.where(index > bipedal.TERRAIN_STARTPAD, push, 0.0)
        velocity = jnp.where(begins, velocity, faster)
        height = jnp.where(begins, height, height + faster)
        begins = left == 1
        left = jnp.where(begins, stretch, left - 1)
        return (height, velocity, left, begins), height

    zero = jnp.zeros_like(pushes[0])
    left = jnp.full_like(stretches[0], bipedal.TERRAIN_STARTPAD)
    carry = zero + jnp.float32(start), zero, left, jnp.zeros_like(zero, bool)
    drawn = jnp.arange(constants.TERRAIN_LENGTH, dtype=jnp.int32), pushes, stretches
    heights: jax.Array = jax.lax.scan(corner, carry, drawn)[1]
    return heights


_profile_of_one = of_one(lambda *given: as_kernel(_profile)(*given))


def rough(key: jax.Array) -> Terrain:
    """Hardcore terrain, drawn as gymnasium draws it (from other random numbers).

    Plain stretches, and between every two of them a stump, stairs or a pit.

    Args:
        key: consumed.

    Returns:
        The terrain.
    """
    keys = jax.random.split(key, 6)
    shape = (constants.TERRAIN_LENGTH,)
    return planned(
        _uniform(keys[0], shape) / np.float32(bipedal.SCALE),
        _whole(keys[1], shape, bipedal.TERRAIN_GRASS // 2, bipedal.TERRAIN_GRASS),
        _whole(keys[2], shape, _STUMP, _PIT + 1),
        _whole(keys[3], shape, 1, 3),
        _whole(keys[4], shape, 3, 5),
        jax.random.bernoulli(keys[5], np.float32(0.5), shape),
    )


def _uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Numbers in [-1, 1), float32 whatever JAX is configured to; the key is consumed."""
    return jax.random.uniform(key, shape, jnp.float32, -1.0, 1.0)


def _whole(key: jax.Array, shape: tuple[int, ...], low: int, high: int) -> jax.Array:
    """Whole numbers in [low, high), int32; the key is consumed."""
    return jax.random.randint(key, shape, low, high, jnp.int32)


def planned(
    pushes: jax.Array,
    stretches: jax.Array,
    kinds: jax.Array,
    stumps: jax.Array,
    others: jax.Array,
    rises: jax.Array,
) -> Terrain:
    """Hardcore terrain from what is drawn for each corner, all [TERRAIN_LENGTH].

    Args:
        pushes: of the ground's slope.
        stretches: lengths of plain stretches, int32.
        kinds: of obstacles: 1 is a stump, 2 stairs, 3 a pit, int32.
        stumps: their sizes, int32.
        others: numbers of stairs, and widths of pits, int32.
        rises: whether stairs go up.

    Returns:
        The terrain; an obstacle is made of the numbers of its first corner.
    """
    return Terrain(*_plan_of_one(pushes, stretches, kinds, stumps, others, rises))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Spot:
    """A corner of hardcore ground, and what is built there.

    Attributes:
        kind: of what begins here or goes on.
        made: how many corners of it are behind.
        size: of a stump, number of stairs, or width of a pit.
        base: height of the ground before it [m].
        up: 1 or -1, where stairs lead.
    """

    kind: jax.Array
    made: jax.Array
    size: jax.Array
    base: jax.Array
    up: jax.Array

    def choose(
        self, stump: jax.Array | int, stairs: jax.Array | int, pit: jax.Array | int
    ) -> jax.Array:
        """By its kind."""
        other = jnp.where(self.kind == _STAIRS, stairs, pit)
        return jnp.where(self.kind == _STUMP, stump, other)


def _plan(*drawn: jax.Array) -> tuple[jax.Array, Boxes]:
    """Heights and boxes from what `planned` takes; arrays are [TERRAIN_LENGTH, B]."""
    heights, spots = as_kernel(_spots)(*drawn)
    return heights, _built(spots)


def _spots(pushes: jax.Array, *drawn: jax.Array) -> tuple[jax.Array, _Spot]:
    """Heights and what is built, corner after corner; see `_plan`."""

    def corner(carry: tuple, given: tuple) -> tuple:
        height, velocity, left, begins, spot = carry
        index, push, stretch, next_kind, stump, other, rises = given

        size, up = spot.choose(stump, other, other), jnp.where(rises, 1, -1)
        fresh = _Spot(spot.kind, left, size, height, up)
        spot = jax.tree.map(lambda new, old: jnp.where(begins, new, old), fresh, spot)
        length = spot.choose(spot.size, spot.size * _STAIR_WIDTH, spot.size + 2)
        left = jnp.where(begins & (spot.kind != _GRASS), length, left)
        spot = dataclasses.replace(spot, made=length - left)

        faster = 0.8 * velocity + 0.01 * jnp.sign(bipedal.TERRAIN_HEIGHT - height)
        faster += jnp.where(index > bipedal.TERRAIN_STARTPAD, push, 0.0)
        grows = (spot.kind == _GRASS) & ~begins
        velocity = jnp.where(grows, faster, velocity)
        share = (spot.made - spot.up).astype(jnp.float32) / _STAIR_WIDTH
        stair = spot.base + share * spot.up * _STEP
        bottom = spot.base - jnp.where(left > 1, _PIT_DEPTH * _STEP, 0.0)
        built = jnp.where(begins, height, spot.choose(height, stair, bottom))
        height = jnp.where(grows, height + faster, built)

        begins = left == 1
        kind = jnp.where(begins, jnp.where(spot.kind == _GRASS, next_kind, _GRASS), spot.kind)
        left = jnp.where(begins, stretch, left - 1)
        following = dataclasses.replace(spot, kind=kind)
        return (height, velocity, left, begins, following), (height, spot)

    level = jnp.full_like(pushes[0], bipedal.TERRAIN_HEIGHT)
    none = jnp.zeros(pushes.shape[1:], jnp.int32)
    start = _Spot(none + _GRASS, none, none, level, none + 1)
    pad = none + bipedal.TERRAIN_STARTPAD
    carry = level, jnp.zeros_like(level), pad, jnp.zeros_like(none, bool), start
    index = jnp.arange(constants.TERRAIN_LENGTH, dtype=jnp.int32)
    passed: tuple[jax.Array, _Spot] = jax.lax.scan(corner, carry, (index, pushes, *drawn))[1]
    return passed


def _built(spot: _Spot) -> Boxes:
    """The box over the stretch behind each corner; arrays are [TERRAIN_LENGTH, B]."""
    index = jnp.arange(constants.TERRAIN_LENGTH, dtype=jnp.int32)[:, None]
    tread = spot.made // _STAIR_WIDTH
    begin = index - spot.choose(spot.made, spot.made % _STAIR_WIDTH, 0)
    end = begin + spot.choose(spot.size, _STAIR_WIDTH, 1)
    top = spot.base + spot.choose(spot.size, tread * spot.up, 0) * _STEP
    bottom = top - spot.choose(spot.size, 1, _PIT_DEPTH) * _STEP
    wall = (spot.made == 0) | (spot.made == spot.size)
    there = (spot.kind != _GRASS) & ((spot.kind != _PIT) | wall)
    # The last boxes may go on behind the ground.
    places = np.arange(constants.TERRAIN_LENGTH + 2 * _STAIR_WIDTH) * constants.TERRAIN_STEP
    place = jnp.asarray(places, jnp.float32)
    low, high = Vec(place[begin], bottom), Vec(place[end], top)
    return Boxes(*(Vec(*(jnp.where(there, v, 0.0) for v in (at.x, at.y))) for at in (low, high)))


_plan_of_one = of_one(_plan)
