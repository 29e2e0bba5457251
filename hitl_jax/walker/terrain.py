"""Terrain in JAX: drawn by gymnasium's rules, from the random numbers of a JAX key."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.walker import bipedal, constants
from hitl_jax.walker.batching.batch_last_vmap import single_from_batch
from hitl_jax.walker.geometry import Vec
from hitl_jax.walker.gpu.kernel import as_kernel
from hitl_jax.walker.physics.boxes import Boxes

_STEP = np.float32(constants.TERRAIN_STEP)
_GRASS, _STUMP, _STAIRS, _PIT = range(4)
_STAIR_WIDTH, _PIT_DEPTH = 4, 4
"""In edges of the ground (`TERRAIN_STEP`)."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Terrain:
    """The ground of one walker; within a step the batch is one more, last axis.

    Attributes:
        heights: of the ground's corners [TERRAIN_LENGTH] [m].
        boxes: the obstacle over the edge from each corner to the next [TERRAIN_LENGTH]; None on
            plain terrain.
    """

    heights: jax.Array
    boxes: Boxes | None = None


def draw(key: jax.Array, hardcore: bool = False) -> Terrain:
    """Draws the terrain of an episode.

    Args:
        key: consumed.
        hardcore: static; whether it has stumps, stairs and pits.

    Returns:
        The terrain.
    """
    return draw_hardcore(key) if hardcore else Terrain(draw_plain(key))


def draw_plain(key: jax.Array) -> jax.Array:
    """Draws plain terrain by gymnasium's rules.

    A flat start, then stretches of 5 to 9 corners; the first corner of each repeats the height
    before.

    Args:
        key: consumed.

    Returns:
        Heights [TERRAIN_LENGTH] [m].
    """
    push_key, stretch_key = jax.random.split(key)
    shape = (constants.TERRAIN_LENGTH,)
    pushes = _uniform(push_key, shape) / np.float32(bipedal.SCALE)
    stretches = _integers(stretch_key, shape, bipedal.TERRAIN_GRASS // 2, bipedal.TERRAIN_GRASS)
    heights: jax.Array = _single_profile(pushes, stretches)
    return heights


def _profile(pushes: jax.Array, stretches: jax.Array) -> jax.Array:
    """Heights of the corners [m] from pushes and stretches; arrays are [TERRAIN_LENGTH, B]."""
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


_single_profile = single_from_batch(lambda *given: as_kernel(_profile)(*given))


def draw_hardcore(key: jax.Array) -> Terrain:
    """Draws hardcore terrain by gymnasium's rules.

    Plain stretches alternate with a stump, stairs or a pit.

    Args:
        key: consumed.

    Returns:
        The terrain.
    """
    keys = jax.random.split(key, 6)
    shape = (constants.TERRAIN_LENGTH,)
    return hardcore_from_draws(
        _uniform(keys[0], shape) / np.float32(bipedal.SCALE),
        _integers(keys[1], shape, bipedal.TERRAIN_GRASS // 2, bipedal.TERRAIN_GRASS),
        _integers(keys[2], shape, _STUMP, _PIT + 1),
        _integers(keys[3], shape, 1, 3),
        _integers(keys[4], shape, 3, 5),
        jax.random.bernoulli(keys[5], np.float32(0.5), shape),
    )


def _uniform(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Numbers in [-1, 1), float32 whatever JAX is configured to; the key is consumed."""
    return jax.random.uniform(key, shape, jnp.float32, -1.0, 1.0)


def _integers(key: jax.Array, shape: tuple[int, ...], low: int, high: int) -> jax.Array:
    """Integers in [low, high), int32; the key is consumed."""
    return jax.random.randint(key, shape, low, high, jnp.int32)


def hardcore_from_draws(
    pushes: jax.Array,
    stretches: jax.Array,
    kinds: jax.Array,
    stumps: jax.Array,
    others: jax.Array,
    rises: jax.Array,
) -> Terrain:
    """Hardcore terrain from the numbers drawn for each corner, all [TERRAIN_LENGTH].

    Args:
        pushes: changes of the slope [m].
        stretches: lengths of plain stretches, int32.
        kinds: of obstacles: 1 is a stump, 2 stairs, 3 a pit, int32.
        stumps: sizes of stumps, int32.
        others: numbers of stairs, and widths of pits, int32.
        rises: whether stairs go up, bool.

    Returns:
        The terrain; an obstacle uses the numbers of its first corner.
    """
    return Terrain(*_single_layout(pushes, stretches, kinds, stumps, others, rises))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Corner:
    """What is built at a corner of hardcore ground.

    Attributes:
        kind: plain ground or an obstacle: `_GRASS`, `_STUMP`, `_STAIRS` or `_PIT`.
        made: number of the obstacle's corners before this one.
        size: of a stump, number of stairs, or width of a pit.
        base: height of the ground before it [m].
        up: 1 where stairs go up, -1 where they go down.
    """

    kind: jax.Array
    made: jax.Array
    size: jax.Array
    base: jax.Array
    up: jax.Array

    def choose(
        self, stump: jax.Array | int, stairs: jax.Array | int, pit: jax.Array | int
    ) -> jax.Array:
        """One of three numbers, by the obstacle's kind."""
        other = jnp.where(self.kind == _STAIRS, stairs, pit)
        return jnp.where(self.kind == _STUMP, stump, other)


def _layout(*drawn: jax.Array) -> tuple[jax.Array, Boxes]:
    """Heights [m] and boxes from the arguments of `hardcore_from_draws`; [TERRAIN_LENGTH, B]."""
    heights, corners = as_kernel(_corners)(*drawn)
    return heights, _boxes_of(corners)


def _corners(pushes: jax.Array, *drawn: jax.Array) -> tuple[jax.Array, _Corner]:
    """Heights [m] and obstacles, corner after corner; see `_layout`."""

    def corner(carry: tuple, given: tuple) -> tuple:
        height, velocity, left, begins, here = carry
        index, push, stretch, next_kind, stump, other, rises = given

        size, up = here.choose(stump, other, other), jnp.where(rises, 1, -1)
        fresh = _Corner(here.kind, left, size, height, up)
        here = jax.tree.map(lambda new, old: jnp.where(begins, new, old), fresh, here)
        length = here.choose(here.size, here.size * _STAIR_WIDTH, here.size + 2)
        left = jnp.where(begins & (here.kind != _GRASS), length, left)
        here = dataclasses.replace(here, made=length - left)

        faster = 0.8 * velocity + 0.01 * jnp.sign(bipedal.TERRAIN_HEIGHT - height)
        faster += jnp.where(index > bipedal.TERRAIN_STARTPAD, push, 0.0)
        grows = (here.kind == _GRASS) & ~begins
        velocity = jnp.where(grows, faster, velocity)
        share = (here.made - here.up).astype(jnp.float32) / _STAIR_WIDTH
        stair = here.base + share * here.up * _STEP
        bottom = here.base - jnp.where(left > 1, _PIT_DEPTH * _STEP, 0.0)
        built = jnp.where(begins, height, here.choose(height, stair, bottom))
        height = jnp.where(grows, height + faster, built)

        begins = left == 1
        kind = jnp.where(begins, jnp.where(here.kind == _GRASS, next_kind, _GRASS), here.kind)
        left = jnp.where(begins, stretch, left - 1)
        following = dataclasses.replace(here, kind=kind)
        return (height, velocity, left, begins, following), (height, here)

    level = jnp.full_like(pushes[0], bipedal.TERRAIN_HEIGHT)
    none = jnp.zeros(pushes.shape[1:], jnp.int32)
    start = _Corner(none + _GRASS, none, none, level, none + 1)
    pad = none + bipedal.TERRAIN_STARTPAD
    carry = level, jnp.zeros_like(level), pad, jnp.zeros_like(none, bool), start
    index = jnp.arange(constants.TERRAIN_LENGTH, dtype=jnp.int32)
    passed: tuple[jax.Array, _Corner] = jax.lax.scan(corner, carry, (index, pushes, *drawn))[1]
    return passed


def _boxes_of(here: _Corner) -> Boxes:
    """The box over the edge that begins at each corner; arrays are [TERRAIN_LENGTH, B]."""
    index = jnp.arange(constants.TERRAIN_LENGTH, dtype=jnp.int32)[:, None]
    tread = here.made // _STAIR_WIDTH
    begin = index - here.choose(here.made, here.made % _STAIR_WIDTH, 0)
    end = begin + here.choose(here.size, _STAIR_WIDTH, 1)
    top = here.base + here.choose(here.size, tread * here.up, 0) * _STEP
    bottom = top - here.choose(here.size, 1, _PIT_DEPTH) * _STEP
    wall = (here.made == 0) | (here.made == here.size)
    there = (here.kind != _GRASS) & ((here.kind != _PIT) | wall)
    # The last boxes may go on behind the ground.
    places = np.arange(constants.TERRAIN_LENGTH + 2 * _STAIR_WIDTH) * constants.TERRAIN_STEP
    place = jnp.asarray(places, jnp.float32)
    low, high = Vec(place[begin], bottom), Vec(place[end], top)
    return Boxes(*(Vec(*(jnp.where(there, v, 0.0) for v in (end.x, end.y))) for end in (low, high)))


_single_layout = single_from_batch(_layout)
