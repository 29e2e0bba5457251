"""Hardcore terrain is drawn by gymnasium's rules, and its contacts and lidar agree with Box2D."""

import dataclasses

import jax
import numpy as np
import official as theirs
import pytest

from hitl_jax.agreement.states import copied
from hitl_jax.envs import HARDCORE_WALKER, Command, jax_pool, make_pool
from hitl_jax.walker import bipedal, constants, from_gymnasium, terrain
from hitl_jax.xla.devices import walker_devices

LANES = 16
DRAWS = 12


@pytest.fixture(scope="module")
def official():
    return theirs.make(hardcore=True)


class _GivenDraws:
    """Stands in for gymnasium's generator and returns given numbers for each corner."""

    def __init__(self, env, pushes, stretches, kinds, stumps, others, rises):
        self._corner = lambda: len(env.terrain_x) - 1
        self._pushes, self._rises = pushes * bipedal.SCALE, rises
        self._integers = {(5, 10): stretches, (1, 4): kinds, (1, 3): stumps, (3, 5): others}

    def uniform(self, low, high):
        return self._pushes[self._corner()]

    def random(self):
        return float(self._rises[self._corner()])

    def integers(self, low, high):
        return 4 if (low, high) == (4, 5) else self._integers[low, high][self._corner()]


def test_terrain_from_equal_draws_is_gymnasiums():
    rng = np.random.default_rng(0)
    shape = (DRAWS, constants.TERRAIN_LENGTH)
    drawn = (
        rng.uniform(-1, 1, shape).astype(np.float32) / np.float32(bipedal.SCALE),
        *(
            rng.integers(*ends, shape).astype(np.int32)
            for ends in ((5, 10), (1, 4), (1, 3), (3, 5))
        ),
        rng.random(shape) < 0.5,
    )
    plan = jax.jit(jax.vmap(terrain.hardcore_from_draws))(*drawn)
    kinds = set()
    for index in range(DRAWS):
        official = theirs.make(hardcore=True)
        official.reset(seed=0)
        official._np_random = _GivenDraws(official, *(values[index] for values in drawn))
        official._generate_terrain(hardcore=True)
        expected = from_gymnasium.terrain_of(official)
        ours = jax.tree.map(lambda leaf, at=index: leaf[at], plan)
        np.testing.assert_allclose(ours.heights, expected.heights, atol=2e-5)
        # Boxes beyond the end of the ground differ; no walker gets there.
        inside = slice(0, constants.NUM_EDGES)
        for mine, other in zip(
            jax.tree.leaves(ours.boxes), jax.tree.leaves(expected.boxes), strict=True
        ):
            np.testing.assert_allclose(mine[inside], other[inside], atol=2e-5)
        boxes = np.stack([ours.boxes.low.x, ours.boxes.high.x, ours.boxes.low.y, ours.boxes.high.y])
        sizes = np.rint((boxes[1::2] - boxes[::2]) / constants.TERRAIN_STEP)
        kinds |= {tuple(size) for size in sizes.T}
    # None, two stumps, a pit's wall, a stair.
    assert kinds == {(0, 0), (1, 1), (2, 2), (1, 4), (4, 1)}


def _tick(walkers, actions):
    """One step of sixteen walkers, with the program of a small pool."""
    rows = np.full(LANES, Command.STEP, np.uint8), np.float32(actions), np.zeros(LANES, np.uint32)
    return jax_pool.tick(*jax.device_put((walkers, *rows), walker_devices(1)[0]))


def _stacked(walkers):
    return jax.tree.map(lambda *leaves: np.stack(leaves), *walkers)


def _put(env, seed, x, y):
    """Begins an episode and moves the walker; Box2D finds contacts after one step."""
    env.reset(seed=seed)
    shift = np.array([x, y]) - np.array(tuple(env.hull.position))
    for body in (env.hull, *env.legs):
        body.position = tuple(np.array(tuple(body.position)) + shift)
    env.step(np.zeros(4))


def _boxes(env):
    shapes = [np.array(body.fixtures[0].shape.vertices) for body in env.terrain]
    return [corners for corners in shapes if len(corners) == 4]


def _stands_on_a_box(env):
    touched = [
        fixture.shape.vertices
        for leg in env.legs
        for entry in leg.contacts
        if entry.contact.touching
        for fixture in (entry.contact.fixtureA, entry.contact.fixtureB)
        if fixture.body not in env.legs
    ]
    return any(len(corners) == 4 for corners in touched)


@pytest.mark.slow
def test_a_step_on_obstacles_is_box2ds(official):
    """Walkers are dropped over an obstacle and act at random."""
    rng = np.random.default_rng(0)
    rows = []
    for seed in range(64):
        official.reset(seed=seed)
        corners = rng.choice(_boxes(official))
        low, high = corners.min(0), corners.max(0)
        _put(
            official, seed, rng.uniform(low[0] - 0.7, high[0] + 0.7), high[1] + rng.uniform(2.3, 3)
        )
        for count in range(40):
            action = rng.uniform(-1, 1, 4).astype(np.float32)
            before = copied(official) if count > 4 and _stands_on_a_box(official) else None
            observation, _, terminated, _, _ = official.step(action)
            if terminated:
                break
            if before is not None:
                rows.append((before, action, observation))
    assert len(rows) > 8 * LANES
    errors = []
    for begin in range(0, 8 * LANES, LANES):
        walkers, actions, expected = zip(*rows[begin : begin + LANES], strict=True)
        _, step = _tick(_stacked(walkers), np.stack(actions))
        errors.append(np.abs(np.asarray(step.observation) - np.stack(expected)))
    error = np.concatenate(errors)
    assert np.median(error) <= 1e-6
    assert np.quantile(error, 0.95) <= 1e-4
    # A foot's ground contact, or an impact, differs in a few steps.
    assert (error.max(1) > 1e-2).mean() <= 0.05


def _stump(env):
    env.reset(seed=0)
    return next(box for box in _boxes(env) if np.ptp(box[:, 1]) < 1)


@pytest.mark.slow
def test_lidar_sees_obstacles(official):
    corners = _stump(official)
    walkers, expected = [], []
    for away in np.linspace(-4, 1, LANES):
        _put(official, 0, corners[:, 0].min() + away, corners[:, 1].max() + 3.2)
        walkers.append(copied(official))
        expected.append(official.step(np.zeros(4))[0][14:])
    _, step = _tick(_stacked(walkers), np.zeros((LANES, 4)))
    np.testing.assert_allclose(step.observation[:, 14:], expected, atol=1e-5)


@pytest.mark.slow
def test_a_hull_that_touches_an_obstacle_has_fallen(official):
    """Walkers fall upside down; some are too high to touch the obstacle in the next step."""
    corners = _stump(official)
    walkers, ends = [], []
    for above in np.linspace(0.9, 1.6, LANES):
        _put(official, 0, corners[:, 0].mean(), corners[:, 1].max() + 2.5)
        hull = np.array([corners[:, 0].mean(), corners[:, 1].max() + above])
        centre = np.array(tuple(official.hull.position))
        for body in (official.hull, *official.legs):
            body.position = tuple(hull - np.array(tuple(body.position)) + centre)
            body.angle += np.pi
            body.linearVelocity = (0, -12)
        official.step(np.zeros(4))
        assert not official.game_over
        walkers.append(copied(official))
        ends.append(official.step(np.zeros(4))[2])
    _, step = _tick(_stacked(walkers), np.zeros((LANES, 4)))
    np.testing.assert_array_equal(step.terminated, ends)
    assert 0 < sum(ends) < LANES


@pytest.mark.slow
def test_the_pools_hardcore_episodes_follow_from_their_seeds():
    seeds = np.arange(3, dtype=np.uint32)
    action = np.zeros((3, 4), np.float32)
    with make_pool("jax", 3, 1, HARDCORE_WALKER) as pool:
        first = pool.step(np.full(3, Command.RESET), action, seeds).observation
        assert len(np.unique(first, axis=0)) == 3
        assert bool(pool.walker(0).terrain.boxes.exist.any())
        again = pool.step(np.full(3, Command.RESET), action, seeds[[0, 0, 2]]).observation
        np.testing.assert_array_equal(again, first[[0, 0, 2]])
        late = jax.device_get(pool.walkers[0])
        after, step = _tick(
            dataclasses.replace(late, steps=late.steps + 1998), np.zeros((LANES, 4))
        )
        assert not step.truncated.any()
        assert _tick(after, np.zeros((LANES, 4)))[1].truncated[:3].all()
