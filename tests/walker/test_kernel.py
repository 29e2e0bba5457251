"""The solver's GPU kernels compute what its CPU programs compute, on an emulator of PTX."""

import functools
import math
import re
import types

import jax
import jax.numpy as jnp
import numpy as np
import ptx_machine
import pytest

from hitl_jax.envs import Command, jax_pool, make_pool
from hitl_jax.walker import constants, terrain
from hitl_jax.walker.batching.masked_subset import apply_masked
from hitl_jax.walker.geometry import Speeds, Vec, pose
from hitl_jax.walker.gpu import kernel, leg_threads, sincos
from hitl_jax.walker.physics import contact_solver, ground, impacts, island, joints, world
from hitl_jax.walker.physics.boxes import Boxes, NearbyGround
from hitl_jax.walker.physics.contacts import match_impulses
from hitl_jax.walker.physics.manifolds import touching_first
from hitl_jax.walker.physics.time_of_impact import Sweep
from hitl_jax.walker.terrain import Terrain
from hitl_jax.xla import gpu

_WALKERS = 3


@pytest.fixture(scope="module")
def state():
    """Walkers after 45 random steps: world, ground, manifolds, contacts and constraints."""
    rng, seeds = np.random.default_rng(0), np.arange(_WALKERS, dtype=np.uint32)
    with make_pool("jax", _WALKERS, 1) as pool:
        for command in (Command.RESET, *[Command.STEP] * 45):
            actions = rng.uniform(-1, 1, (_WALKERS, 4)).astype(np.float32)
            pool.step(np.full(_WALKERS, command), actions, seeds)
        walkers = [jax.device_get(pool.walker(index)) for index in range(_WALKERS)]
    together = jax.tree.map(lambda *leaves: np.stack(leaves, axis=-1), *walkers)
    before, heights = together.world, together.terrain.heights
    return before, *jax.jit(_prepared)(before, heights)


def _prepared(before, heights):
    bodies = pose(before.place, before.angle)
    legs = world.legs_of(bodies)
    near = ground.near_parts(Terrain(heights), world.legs_left(legs))
    manifold = touching_first(near.manifolds(legs))
    contacts = match_impulses(before.contacts, manifold)
    speed = jnp.asarray(constants.SPEEDS[:, None], jnp.float32) * jnp.ones((4, _WALKERS))
    joint = joints.prepare(bodies, before.angle, speed, constants.TORQUE * jnp.ones_like(speed))
    return near, manifold, contacts, joint, contact_solver.prepare(manifold, legs)


def _written(function, parts, args):
    """The PTX of a kernel."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gpu, "on_gpu", lambda: True)
        return kernel.kernel_text(function, parts, args)


def _emulated(function, parts=(), block_size=None):
    """A function as a GPU's kernel, run by the emulator."""

    def call(*args):
        batch = max(leaf.shape[-1] for leaf in jax.tree.leaves(args))
        args = jax.tree.map(
            lambda leaf: np.broadcast_to(leaf, (*np.shape(leaf)[:-1], batch)).copy(), args
        )
        # A new function object: JAX would reuse what it has traced for a CPU.
        text, shapes = _written(lambda *args: function(*args), parts, args)
        results = [np.zeros(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(shapes)]
        threads = batch * math.prod(parts)
        ptx_machine.run(text, threads, [*jax.tree.leaves(args), *results], block_size)
        return jax.tree.unflatten(jax.tree.structure(shapes), results)

    return call


def _assert_kernel_equals_cpu(function, args, parts=(), block_size=None):
    """A function as one kernel gives what it gives on a CPU."""
    _are_close(_emulated(function, parts, block_size)(*args), jax.jit(function)(*args))


def _are_close(got, expected):
    for one, other in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5, rtol=2e-5)


def _assert_kernels_equal_cpu(function, args):
    """A part of a step, with its kernels, gives what it gives on a CPU."""
    expected = jax.jit(function)(*args)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gpu, "on_gpu", lambda: True)
        patch.setattr(leg_threads, "as_kernel", _emulated)
        got = function(*args)
    _are_close(got, expected)


def _speeds(world):
    return Speeds(world.velocity, world.spin)


@pytest.mark.slow
def test_velocity_iterations(state):
    before, _, _, contacts, joint, constraints = state
    assert contacts.touching[:, 1::2].any()
    _assert_kernels_equal_cpu(
        island.solve_velocities, (_speeds(before), before.impulses, joint, constraints, contacts)
    )


@pytest.mark.slow
def test_velocity_iterations_with_contacts_of_all_parts(state):
    """Thighs touch too, and shins touch more than two edges."""
    before, _, _, contacts, joint, constraints = state
    everywhere = jax.tree.map(
        lambda leaf: np.broadcast_to(leaf[:1, 1:2], leaf.shape), (contacts, constraints.points)
    )
    contacts, points = everywhere
    matrices = jax.tree.map(
        lambda leaf: np.broadcast_to(leaf[:1, 1:2], leaf.shape),
        (constraints.matrix, constraints.inverse),
    )
    constraints = contact_solver.ContactConstraints(constraints.inverse_masses, points, *matrices)
    _assert_kernels_equal_cpu(
        island.solve_velocities, (_speeds(before), before.impulses, joint, constraints, contacts)
    )


def _on_stairs(near, place):
    """The ground, with two stairs under each part that it touches or overlaps."""
    steps = np.array([0.1, -0.2, 0, 0], np.float32)[:, None, None]
    left, top = place.x[1:] + steps, place.y[1:] - 0.45 + steps / 4
    wide = np.where(steps != 0, 0.35, 0).astype(np.float32)
    boxes = Boxes(Vec(left, top - 1), Vec(left + wide, top + 0 * left))
    return NearbyGround(near.edges, boxes)


@pytest.mark.parametrize("hardcore", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_contacts_of_parts(state, hardcore):
    before, near, _, contacts, _, _ = state
    legs = world.legs_of(pose(before.place, before.angle))
    assert contacts.touching.any()
    if hardcore:
        near = _on_stairs(near, before.place)
        assert near.manifolds(legs).touching[4:].any()
    _assert_kernel_equals_cpu(
        world._collide, (legs, near, before.contacts, before.ground_contact), parts=(4,)
    )


def test_position_iterations(state):
    before, _, manifold, _, joint, _ = state
    _assert_kernels_equal_cpu(
        island.solve_positions, (before.place, before.angle, joint.side, manifold)
    )


@pytest.mark.slow
def test_position_iterations_of_separated_joints(state):
    """Joints of both legs of one walker are apart: it needs all iterations, the others do not."""
    before, _, manifold, _, joint, _ = state
    shift = np.zeros((5, _WALKERS), np.float32)
    shift[[1, 4], 0] = 0.2, -0.1
    place = Vec(before.place.x + shift, before.place.y)
    angle = before.angle + shift
    _assert_kernels_equal_cpu(island.solve_positions, (place, angle, joint.side, manifold))


@pytest.mark.parametrize("hardcore", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_impacts_have_a_thread_for_each_part(state, hardcore):
    before, near, _, contacts, _, _ = state
    if hardcore:
        near = _on_stairs(near, Vec(before.place.x, before.place.y - 0.03))
    start = Vec(before.place.x[1:], before.place.y[1:])
    end = Vec(start.x + 0.02, start.y - 0.1)
    moved = impacts.LegMotion(
        sweep=Sweep(start, before.angle[1:], end, before.angle[1:] + 0.1),
        done=jnp.zeros((4, _WALKERS)),
        speeds=Speeds(Vec(jnp.ones((4, _WALKERS)), -5 * jnp.ones((4, _WALKERS))), before.spin[1:]),
        contacts=contacts,
        ground_contact=before.ground_contact,
    )
    assert (jax.jit(impacts.solve_impacts)(moved, near).done > 0).any()
    needed = jnp.arange(4 * _WALKERS).reshape(4, _WALKERS) % 2 == 0
    work = functools.partial(apply_masked, impacts.solve_impacts)
    _assert_kernel_equals_cpu(work, (needed, moved, near), parts=(4,))


def test_terrain():
    pushes = np.linspace(-0.03, 0.03, 200 * _WALKERS, dtype=np.float32).reshape(200, _WALKERS)
    stretches = np.arange(200 * _WALKERS, dtype=np.int32).reshape(200, _WALKERS) % 5 + 5
    _assert_kernel_equals_cpu(terrain._profile, (pushes, stretches))


def test_hardcore_terrain():
    rng = np.random.default_rng(0)
    shape = (constants.TERRAIN_LENGTH, _WALKERS)
    ends = ((5, 10), (1, 4), (1, 3), (3, 5))
    integers = [rng.integers(*each, shape).astype(np.int32) for each in ends]
    pushes = rng.uniform(-0.03, 0.03, shape).astype(np.float32)
    _assert_kernel_equals_cpu(terrain._corners, (pushes, *integers, rng.random(shape) < 0.5))


def test_sine_and_cosine_are_as_good_as_float32():
    angle = np.linspace(-50, 50, 200_001, dtype=np.float32)
    exact = angle.astype(np.float64)
    np.testing.assert_allclose(jax.jit(sincos.sine)(angle), np.sin(exact), atol=2e-7)
    np.testing.assert_allclose(jax.jit(sincos.cosine)(angle), np.cos(exact), atol=2e-7)


@pytest.mark.parametrize("parts", [(), (1,), (4,), (2, 2)])
def test_threads_beyond_the_batch_do_nothing(parts):
    shape = (*parts, 3)
    text, _ = _written(lambda a: a + 1, parts, (np.zeros(shape, np.float32),))
    given = np.arange(math.prod(shape), dtype=np.float32)
    result = np.zeros(given.size + 2, np.float32)
    ptx_machine.run(text, given.size + 2, [given, result])
    assert result.tolist() == [*(given + 1), 0, 0]


def test_sums_over_threads_are_refused():
    with pytest.raises(NotImplementedError, match="over threads"):
        kernel.kernel_text(lambda a: a + a.sum(), (), (np.zeros(3, np.float32),))


def test_arguments_of_different_batches_are_refused():
    args = (np.zeros((2, 3), np.float32), np.zeros(4, np.float32))
    with pytest.raises(ValueError, match=r"shape \(4,\): must end with \(3,\)"):
        kernel.kernel_text(lambda a, b: (a, b), (), args)


@pytest.mark.parametrize("block_size", [None, 4, 8])
def test_threads_of_a_walker_exchange_numbers(block_size):
    def told(a):
        legs = jnp.flip(a, -3)
        known = a[0] > 0
        return legs, jnp.flip(a, (0, -2)), jnp.where(jnp.flip(known, -2), 1, jnp.int32(0))

    a = np.arange(24, dtype=np.float32).reshape(2, 2, 2, 3) % 5 - 2
    _assert_kernel_equals_cpu(
        told, (a,), parts=(2, 2), block_size=block_size
    )  # With 8 the last block is half empty.


def test_threads_of_a_walker_leave_a_loop_together():
    """A loop runs as often as the slowest thread needs; the others then change nothing."""

    def halved(a):
        def one(carry):
            a, told = carry
            return jnp.where(a > 1, a / 2, a), told + jnp.where(jnp.flip(a, -2) > 1, 1.0, 0.0)

        return jax.lax.while_loop(lambda carry: (carry[0] > 1).any(), one, (a, 0 * a))

    _assert_kernel_equals_cpu(
        halved, (np.array([1, 90, 7, 3], np.float32).reshape(2, 2, 1),), parts=(2, 2)
    )


@pytest.mark.parametrize(
    ("function", "parts"),
    [
        (lambda a: jnp.flip(a, -2), (4,)),
        (lambda a: jnp.flip(a, -3), (2, 3)),
        (lambda a: jnp.flip(a, -1), (2, 2)),
        (lambda a: jnp.flip(a, -1), ()),
        (lambda a: jax.lax.cond((a > 0).any(), lambda: jnp.flip(a, -2), lambda: a), (2, 2)),
    ],
)
def test_exchanges_that_some_threads_may_not_reach_are_refused(function, parts):
    with pytest.raises(NotImplementedError, match="flipped, or in a branch"):
        _written(function, parts, (np.zeros((*parts, 3), np.float32),))


@pytest.mark.parametrize(
    ("threads", "parts", "cores", "block"),
    [(1002, 1, 132, 1), (4008, 4, 132, 4), (16_384, 4, 132, 16), (10**6, 4, 132, 32), (8, 4, 1, 4)],
)
def test_blocks_are_small_while_a_gpu_has_room(threads, parts, cores, block):
    assert kernel.block_size(threads, parts, cores) == block


@pytest.mark.parametrize(
    ("hardcore", "terrains"),
    [(False, "walker_profile"), pytest.param(True, "walker_corners", marks=pytest.mark.slow)],
)
def test_a_tick_on_a_gpu_is_kernels_with_names_of_their_own(monkeypatch, hardcore, terrains):
    jax.clear_caches()  # What is traced for a GPU is none for a CPU, and the reverse.
    with monkeypatch.context() as patch:
        patch.setattr(gpu, "on_gpu", lambda: True)
        numbers = jnp.zeros(7, jnp.uint32)
        walkers = jax.eval_shape(lambda: jax_pool.new_walkers(numbers, hardcore))
        tick = jax.make_jaxpr(jax_pool.tick.__wrapped__)(
            walkers, numbers.astype(jnp.int32), jnp.zeros((7, 4)), numbers
        )
    jax.clear_caches()
    names = re.findall(r"\('name', '(walker\w*)'\)", str(tick))
    assert names == re.findall(r"\.entry (\w+)\(", str(tick))
    solver = "walker_velocity_iterations", "walker_position_iterations"
    assert sorted(names) == sorted([terrains, "walker_collide", *solver, "walker_apply_masked"])
    # A condition would wait for the host.
    assert "cond" not in {eqn.primitive.name for eqn in tick.jaxpr.eqns}


def test_a_lambda_makes_a_kernel_with_a_name():
    text, _ = _written(functools.partial(lambda b, a: a + b, 1), (), (np.zeros(3, np.float32),))
    assert ".entry walker_lambda(" in text


def test_on_a_cpu_as_kernel_returns_the_function():
    with jax.default_device(jax.devices("cpu")[0]):
        assert kernel.as_kernel(jnp.sin) is jnp.sin


@pytest.mark.parametrize(
    ("platform", "capability", "taken"),
    [("gpu", "9.0", True), ("gpu", "7.5", False), ("gpu", "gfx942", False), ("cpu", None, False)],
)
def test_kernels_are_for_gpus_with_their_instructions(monkeypatch, platform, capability, taken):
    device = types.SimpleNamespace(platform=platform, compute_capability=capability)
    monkeypatch.setattr(jax, "devices", lambda *_: [device])
    assert gpu.on_gpu() is taken


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda a: (a > 0) < (a > 1), "lt of pred"),
        (lambda a: jax.lax.round(a), "halves away"),
        (lambda a: jax.lax.cumsum(jnp.stack([a, a]), reverse=True), "cumsum from behind"),
        (lambda a: jax.lax.scan(lambda c, _: (c + 1, c), a, None, length=2), "scan over nothing"),
        (
            lambda a: jax.lax.scan(lambda c, x: (c + x, x), a, jnp.stack([a, a]), reverse=True),
            "scan from behind",
        ),
        (lambda a: a[:2].sum() + a, "slice of threads"),
    ],
)
def test_operations_that_kernels_do_not_have_are_refused(function, message):
    with pytest.raises(NotImplementedError, match=message):
        kernel.kernel_text(function, (), (np.zeros(3, np.float32),))


def test_results_without_the_batch_are_refused():
    with pytest.raises(ValueError, match=r"result of shape \(3,\): must end with the batch"):
        kernel.kernel_text(lambda a: (a, jnp.arange(3.0)), (), (np.zeros(5, np.float32),))
