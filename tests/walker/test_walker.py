"""The walker in JAX agrees with gymnasium's on Box2D; its pool. All tests share one program."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import official as theirs
import pytest

from hitl_jax import walker
from hitl_jax.agreement.returns import distance
from hitl_jax.agreement.states import copied
from hitl_jax.envs import Command, jax_pool, make_pool
from hitl_jax.walker import bipedal, constants, terrain
from hitl_jax.walker.batching.batch_last_vmap import single_from_batch
from hitl_jax.walker.batching.masked_subset import apply_to_subset
from hitl_jax.walker.geometry import Vec
from hitl_jax.walker.physics import contacts, manifolds
from hitl_jax.walker.terrain import Terrain
from hitl_jax.xla.devices import walker_devices
from hitl_jax.xla.threefry import make_key

LANES = 16
"""Walkers of the one program: the least number of a device."""


@pytest.fixture(scope="module")
def official():
    return theirs.make()


def step(walkers, actions, command=Command.STEP):
    """One tick of 16 walkers, on the device of a small pool."""
    rows = np.full(LANES, command, np.uint8), np.float32(actions), np.zeros(LANES, np.uint32)
    return jax_pool.tick(*jax.device_put((walkers, *rows), walker_devices(1)[0]))


def stacked(walkers):
    """Sixteen walkers; the last one is repeated if there are fewer."""
    walkers = (walkers + [walkers[-1]] * LANES)[:LANES]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *walkers)


def played(env, seed, steps, noise=0.0):
    """Rows (walker before the step, action, observation, terminated) of a scripted episode."""
    observation, _ = env.reset(seed=seed)
    gait, rng = theirs.gait(), np.random.default_rng(seed)
    rows = []
    for _ in range(steps):
        before = copied(env)
        action = np.float32(gait(observation) + rng.normal(0, noise, 4))
        observation, _, terminated, _, _ = env.step(action)
        rows.append((before, action, observation, terminated))
        if terminated:
            break
    return rows


def test_masses_and_friction_equal_box2ds(official):
    official.reset(seed=0)
    bodies = [official.hull, *official.legs]
    centres = np.array([tuple(body.localCenter) for body in bodies])
    masses = np.array([body.mass for body in bodies])
    inertias = np.array([body.inertia for body in bodies]) - masses * (centres**2).sum(1)
    np.testing.assert_allclose(1 / constants.INVERSE_MASS, masses, rtol=1e-6)
    np.testing.assert_allclose(1 / constants.INVERSE_INERTIA, inertias, rtol=1e-6)
    np.testing.assert_allclose(constants.HULL_CENTRE, centres[0], atol=1e-7)
    np.testing.assert_array_equal(centres[1:], 0)
    ground_friction = official.fd_edge.friction
    for leg in official.legs:
        assert np.sqrt(leg.fixtures[0].friction * ground_friction) == pytest.approx(
            constants.FRICTION
        )


def test_joints_equal_box2ds(official):
    official.reset(seed=0)
    bodies = [official.hull, *official.legs]
    for index, joint in enumerate(official.joints):
        first, second = constants.JOINTS[index]
        assert (joint.bodyA, joint.bodyB) == (bodies[first], bodies[second])
        assert joint.lowerLimit == pytest.approx(constants.LOWER[index])
        assert joint.upperLimit == pytest.approx(constants.UPPER[index])
        bend = joint.bodyB.angle - joint.bodyA.angle - constants.REFERENCE[index]
        assert joint.angle == pytest.approx(bend, abs=1e-6)
        anchors = ((joint.bodyA, joint.anchorA), (joint.bodyB, joint.anchorB))
        for (body, anchor), local in zip(anchors, constants.ANCHORS[index], strict=True):
            point = body.GetWorldPoint(body.localCenter + local.tolist())
            np.testing.assert_allclose(point, anchor, 1e-6)


@pytest.mark.slow
def test_a_step_from_a_copied_state_is_box2ds(official):
    rows = [row for seed in range(4) for row in played(official, seed, 200, 0.3)[5::7]]
    errors = []
    for begin in range(0, len(rows), LANES):
        some = rows[begin : begin + LANES]
        walkers, actions = stacked([row[0] for row in some]), [row[1] for row in some]
        actions = (actions + [actions[-1]] * LANES)[:LANES]
        _, after = step(walkers, actions)
        expected = np.array([row[2] for row in some])
        errors.append(np.abs(np.asarray(after.observation)[: len(some)] - expected))
    error = np.concatenate(errors)
    assert len(error) > 80
    assert np.median(error) <= 1e-6
    assert np.quantile(error, 0.95) <= 1e-4
    # A foot's ground contact, or an impact, differs in a few steps.
    assert (error.max(1) > 1e-2).mean() <= 0.05


@pytest.mark.slow
def test_forty_steps_with_equal_actions_stay_near_box2ds(official):
    episodes = [played(official, seed, 60)[20:] for seed in range(3)]
    assert all(len(episode) == 40 for episode in episodes)
    walkers = stacked([episode[0][0] for episode in episodes])
    for count in range(40):
        actions = np.array([episode[count][1] for episode in episodes])
        walkers, after = step(walkers, np.resize(actions, (LANES, 4)))
    expected = np.array([episode[-1][2] for episode in episodes])
    np.testing.assert_allclose(after.observation[:3], expected, atol=5e-3)


def test_a_reset_on_gymnasiums_terrain_is_gymnasiums(official):
    walkers, expected = [], []
    for seed in range(3):
        observation, _ = official.reset(seed=seed)
        drawn = bipedal.draw_start(bipedal.random_numbers(seed))
        walkers.append(
            walker.new_walker_on(Terrain(np.float32(drawn.heights)), np.float32(drawn.push))
        )
        expected.append(observation)
    first, after = step(stacked(walkers), np.zeros((LANES, 4)))
    np.testing.assert_allclose(after.observation[:3], expected, atol=1e-5)
    assert (np.asarray(first.steps) == 0).all()


def test_falls_end_episodes_when_gymnasiums_end(official):
    falls = [played(official, seed, 1600, 0.6)[-LANES:] for seed in range(4)]
    falls = [rows for rows in falls if rows[-1][3]]
    assert len(falls) >= 2
    for rows in falls:
        walkers, actions = stacked([row[0] for row in rows]), [row[1] for row in rows]
        _, after = step(walkers, np.resize(actions, (LANES, 4)))
        terminated = np.asarray(after.terminated)[: len(rows)]
        np.testing.assert_array_equal(terminated, [row[3] for row in rows])
        assert float(after.reward[len(rows) - 1]) == -100


def test_the_goal_terminates_and_the_limit_truncates():
    one = jax.tree.map(np.asarray, walker.new_walker(make_key(0)))
    one = dataclasses.replace(one, steps=np.int32(0))
    place = dataclasses.replace(
        one.world.place, x=one.world.place.x + np.float32(constants.GOAL - 4)
    )
    there = dataclasses.replace(one, world=dataclasses.replace(one.world, place=place))
    late = dataclasses.replace(one, steps=np.int32(1599))
    later = dataclasses.replace(one, steps=np.int32(1598))
    _, after = step(stacked([there, late, later, one]), np.zeros((LANES, 4)))
    assert np.asarray(after.terminated)[:4].tolist() == [True, False, False, False]
    assert np.asarray(after.truncated)[:4].tolist() == [False, True, False, False]


def test_terrain_is_drawn_as_gymnasium_draws_it():
    keys = jax.random.split(jax.random.key(0), 400)
    ours = np.asarray(jax.jit(jax.vmap(terrain.draw_plain))(keys))
    drawn = np.array([bipedal.draw_plain(bipedal.random_numbers(seed)) for seed in range(400)])
    assert (ours[:, :20] == ours[0, 0]).all()
    for values in (lambda x: x[:, 60], lambda x: x[:, -1], lambda x: np.diff(x)[:, 100]):
        assert distance(values(ours), values(drawn)) < 0.1
    # The first corner of a stretch repeats the height before: about one in six and a half.
    flat = [(np.diff(heights[:, 30:]) == 0).mean() for heights in (ours, drawn)]
    assert flat[0] == pytest.approx(flat[1], abs=0.005)


def test_new_walkers_differ_by_key():
    one, other = (walker.new_walker(make_key(seed)) for seed in (1, 2))
    assert (one.terrain.heights != other.terrain.heights).any()
    assert one.world.velocity.x[0] != other.world.velocity.x[0]


def test_single_from_batch_maps_over_any_axes():
    @single_from_batch
    def total(values, factor):  # [n, B], [B]
        return (values * factor).sum(0)

    values, factor = jnp.arange(24.0).reshape(2, 3, 4), jnp.arange(6.0).reshape(2, 3)
    np.testing.assert_allclose(total(values[0, 0], factor[0, 1]), values[0, 0].sum())
    mapped = jax.jit(jax.vmap(jax.vmap(total)))(values, factor)
    np.testing.assert_allclose(mapped, (values * factor[..., None]).sum(-1))
    mapped = jax.vmap(total, in_axes=(0, None))(values[0], 2.0)
    np.testing.assert_allclose(mapped, 2 * values[0].sum(-1))


@pytest.mark.parametrize("share", [0.0, 0.1, 0.7, 1.0])
def test_apply_to_subset_changes_those_that_need_it_alone(share):
    needed = np.random.default_rng(0).uniform(size=100) < share
    state = (jnp.arange(100.0), jnp.zeros((2, 100)))
    done = apply_to_subset(needed, lambda s, c: (s[0] + c, s[1] - 1), state, jnp.full(100, 5.0))
    np.testing.assert_array_equal(done[0], np.arange(100) + 5 * needed)
    np.testing.assert_array_equal(done[1], np.tile(-1.0 * needed, (2, 1)))


@pytest.mark.parametrize("slots", [manifolds.SLOTS, 2 * manifolds.SLOTS])
@pytest.mark.parametrize("leads", [False, True])
def test_touching_manifolds_come_first_and_keep_their_order(slots, leads):
    num_parts, batch = 4, 50
    rng = np.random.default_rng(slots)
    # Each slot, part and walker has a number of its own; at most four slots touch.
    number = rng.permutation(slots * num_parts * batch).reshape(slots, num_parts, batch)
    order = rng.permuted(np.arange(slots)[:, None, None] + 0 * number, axis=0)
    touching = order < rng.integers(0, manifolds.SLOTS + 1, (num_parts, batch))
    leading = leads & (rng.uniform(size=touching.shape) < 0.5)
    real = jnp.asarray(number, jnp.float32)
    vec = Vec(real, -real)
    whole = jnp.asarray(number, jnp.int32)
    manifold = manifolds.Manifold(
        edge=whole,
        on_edge=whole % 2 == 0,
        normal=vec,
        plane=vec,
        points=(vec, vec),
        keys=(whole, -whole),
        valid=(jnp.asarray(touching), jnp.zeros(touching.shape, bool)),
    )
    moved = manifolds.touching_first(manifold, jnp.asarray(leading))
    for part in range(num_parts):
        for walker_ in range(batch):
            met, first = touching[:, part, walker_], leading[:, part, walker_]
            places = [*np.flatnonzero(met & first), *np.flatnonzero(met & ~first)]
            places = [*places, *np.flatnonzero(~met)][: manifolds.SLOTS]
            here = number[places, part, walker_]
            np.testing.assert_array_equal(moved.edge[:, part, walker_], here)
            np.testing.assert_array_equal(moved.keys[1][:, part, walker_], -here)
            np.testing.assert_array_equal(moved.points[1].y[:, part, walker_], -here)
            np.testing.assert_array_equal(moved.on_edge[:, part, walker_], here % 2 == 0)
            np.testing.assert_array_equal(moved.touching[:, part, walker_], met[places])


def test_impulses_follow_their_edge_and_point_to_another_slot():
    before = contacts.no_contacts(1)
    edge = jnp.array([7, 8, 9, 10], jnp.int32)[:, None, None] + jnp.zeros_like(before.edge)
    keys = (jnp.zeros_like(edge) + 1, jnp.zeros_like(edge) + 2)
    there = jnp.ones(edge.shape, bool)
    normal = (edge.astype(jnp.float32), 10 * edge.astype(jnp.float32))
    before = contacts.Contacts(edge, keys, (there, there), normal, normal)
    now = jnp.array([9, 11, 7, 8], jnp.int32)[:, None, None] + jnp.zeros_like(edge)
    blank = Vec(*jnp.zeros((2, *edge.shape)))
    swapped, only_first = (keys[1], keys[0]), (there, ~there)
    manifold = manifolds.Manifold(now, there, blank, blank, (blank, blank), swapped, only_first)
    after = contacts.match_impulses(before, manifold)
    expected = np.array([90.0, 0.0, 70.0, 80.0])
    for part in range(4):
        np.testing.assert_array_equal(after.normal[0][:, part, 0], expected)
        np.testing.assert_array_equal(after.friction[1][:, part, 0], expected / 10)
    stands = contacts.ground_contact_after(jnp.ones((4, 1), bool), before, after)
    assert not stands.any()  # Contact 10 ended and 11 began: the left one, 10, decides.


def test_the_pools_episodes_follow_from_their_seeds():
    seeds = np.arange(3, dtype=np.uint32)
    action = np.random.default_rng(0).uniform(-1, 1, (3, 4)).astype(np.float32)
    with make_pool("jax", 3) as pool:
        first = pool.step(np.full(3, Command.RESET), action, seeds)
        assert (first.reward == 0).all()
        second = pool.step(np.full(3, Command.STEP), action, seeds)
        # One walker idles, one steps, one begins the first one's episode.
        command = np.array([Command.IDLE, Command.STEP, Command.RESET])
        third = pool.step(command, action, seeds[[0, 1, 0]])
        np.testing.assert_array_equal(third.observation[0], second.observation[0])
        assert (third.observation[1] != second.observation[1]).any()
        np.testing.assert_array_equal(third.observation[2], first.observation[0])
        again = pool.step(np.full(3, Command.STEP), action[[0, 1, 0]], seeds)
        np.testing.assert_array_equal(again.observation[2], second.observation[0])


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_fully")
def test_a_step_depends_on_neither_lane_nor_other_walkers():
    rng, rows = np.random.default_rng(0), []
    walkers = stacked([walker.new_walker(make_key(seed)) for seed in range(LANES)])
    for count in range(60):
        actions = rng.uniform(-1, 1, (LANES, 4)).astype(np.float32)
        if count % 2:  # One walker after the other, in the air and on the ground.
            lane = count // 2 % LANES
            rows.append(
                (jax.tree.map(lambda leaf, at=lane: np.array(leaf[at]), walkers), actions[lane])
            )
        walkers, _ = step(walkers, actions)
    order = rng.permutation(len(rows))
    found = {}
    for begin in (0, 5, 9):
        some = order[begin : begin + LANES]
        _, after = step(stacked([rows[i][0] for i in some]), np.stack([rows[i][1] for i in some]))
        for lane, i in enumerate(some):
            seen = np.asarray(after.observation[lane])
            np.testing.assert_array_equal(found.setdefault(i, seen), seen)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_fully")
def test_many_walkers_are_stepped_in_blocks(monkeypatch):
    def stepped(num):
        seeds = np.arange(num, dtype=np.uint32)
        with make_pool("jax", num, 1) as pool:
            actions = np.zeros((num, 4), np.float32)
            pool.step(np.full(num, Command.RESET), actions, seeds)
            return pool.step(np.full(num, Command.STEP), actions + 1, seeds).observation

    few = stepped(3)
    # Many more than the eight that `apply_to_subset` works on at a time.
    monkeypatch.setattr(jax_pool, "MAX_LANES", 9 * LANES)
    many = stepped(18 * LANES)
    np.testing.assert_array_equal(many[:3], few)
    assert len(np.unique(many, axis=0)) == len(many)
