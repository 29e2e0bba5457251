"""The solver's loops as a GPU's kernels, on a slow machine of the tests' own."""

import functools
import types

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import ptx_machine
import pytest

from hitl_jax.envs import WALKER
from hitl_jax.walker import (
    copying,
    grips,
    ground,
    hinges,
    impact,
    kernel,
    parts,
    terrain,
    touch,
    world,
)
from hitl_jax.walker.plane import Speeds, Vec, pose
from hitl_jax.walker.rarely import where_needed
from hitl_jax.walker.sweep import Sweep
from hitl_jax.walker.terrain import Terrain
from hitl_jax.walker.thread import cosine, sine

_WALKERS = 3


@pytest.fixture(scope="module")
def now():
    """Gymnasium's walkers when they have stumbled for a while, and what a step is made of."""
    env = gymnasium.make(WALKER, disable_env_checker=True).unwrapped
    worlds, heights = [], []
    for seed in range(_WALKERS):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(45):
            env.step(rng.uniform(-1, 1, 4).astype(np.float32))
        worlds.append(copying.world_of(env))
        heights.append(copying.terrain_of(env).heights)
    before = jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *worlds)
    return before, *jax.jit(_prepared)(before, np.stack(heights, axis=-1))


def _prepared(before, heights):
    bodies = pose(before.place, before.angle)
    legs = world.legs_of(bodies)
    near = ground.near_parts(Terrain(heights), world.legs_left(legs))
    manifold = touch.forward(near.touch(legs))
    contacts = touch.remember(before.contacts, manifold)
    speed = jnp.asarray(parts.SPEEDS[:, None], jnp.float32) * jnp.ones((4, _WALKERS))
    hinge = hinges.prepare(bodies, before.angle, speed, parts.TORQUE * jnp.ones_like(speed))
    return near, manifold, contacts, hinge, grips.prepare(manifold, legs)


def _agree(function, args, num_parts=None, tolerance=2e-5):
    """The text does what the function does, as it is for a GPU, and that what it is on a CPU."""
    args = jax.tree.map(
        lambda leaf: np.broadcast_to(leaf, (*np.shape(leaf)[:-1], _WALKERS)).copy(), args
    )
    expected = jax.jit(function)(*args)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("kernel", "grips", "once", "rarely", "world"):
            patch.setattr(f"hitl_jax.walker.{module}.on_gpu", lambda: True)
        # Not the same object: JAX would give what it has traced for a CPU.
        text, told = kernel.written(lambda *args: function(*args), num_parts, args)
    results = [np.zeros(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(told)]
    threads = _WALKERS * (num_parts or 1)
    ptx_machine.run(text, threads, [*jax.tree.leaves(args), *results])
    for got, leaf in zip(results, jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(got, leaf, atol=tolerance, rtol=tolerance)


def _motion(before, contacts, grip):
    normal, along = grips.begin(grip, contacts)
    impulses = [jax.tree.map(lambda leaf, i=i: leaf[i], before.impulses) for i in range(4)]
    return world._Motion(world._rows(before.velocity, before.spin), impulses, normal, along)


@pytest.mark.parametrize("many", [False, True])
def test_velocity_rounds(now, many):
    before, _, _, contacts, hinge, grip = now
    flags = jnp.full(_WALKERS, many)
    args = (flags, _motion(before, contacts, grip), hinge, grip)
    _agree(world._either_rounds, args)


def test_position_rounds(now):
    before, _, manifold, _, hinge, _ = now
    carry = before.place, before.angle, jnp.ones(_WALKERS, bool)
    rounds = functools.partial(world._position_rounds, 0)
    _agree(rounds, (carry, (hinge.side, manifold)))


def test_impacts_have_a_thread_for_each_part(now):
    before, near, _, contacts, _, _ = now
    start = Vec(before.place.x[1:], before.place.y[1:])
    end = Vec(start.x + 0.02, start.y - 0.1)
    moved = impact.Moved(
        sweep=Sweep(start, before.angle[1:], end, before.angle[1:] + 0.1),
        done=jnp.zeros((4, _WALKERS)),
        speeds=Speeds(Vec(jnp.ones((4, _WALKERS)), -5 * jnp.ones((4, _WALKERS))), before.spin[1:]),
        contacts=contacts,
        feet=before.feet,
    )
    assert (jax.jit(impact.land)(moved, near).done > 0).any()
    needed = jnp.arange(4 * _WALKERS).reshape(4, _WALKERS) % 2 == 0
    work = functools.partial(where_needed, impact.land)
    _agree(work, (needed, moved, near), num_parts=4)


def test_terrain(now):
    pushes = np.linspace(-0.03, 0.03, 200 * _WALKERS, dtype=np.float32).reshape(200, _WALKERS)
    stretches = np.arange(200 * _WALKERS, dtype=np.int32).reshape(200, _WALKERS) % 5 + 5
    _agree(terrain._profile, (pushes, stretches))


def test_sine_and_cosine_are_as_good_as_float32():
    angle = np.linspace(-50, 50, 200_001, dtype=np.float32)
    exact = angle.astype(np.float64)
    np.testing.assert_allclose(jax.jit(sine)(angle), np.sin(exact), atol=2e-7)
    np.testing.assert_allclose(jax.jit(cosine)(angle), np.cos(exact), atol=2e-7)


def test_threads_beyond_the_batch_do_nothing():
    text, _ = kernel.written(lambda a: a + 1, None, (np.zeros(3, np.float32),))
    given, told = np.zeros(3, np.float32), np.zeros(5, np.float32)
    ptx_machine.run(text, 5, [given, told])
    assert told.tolist() == [1, 1, 1, 0, 0]


def test_what_threads_would_have_to_tell_each_other_is_refused():
    with pytest.raises(NotImplementedError, match="over threads"):
        kernel.written(lambda a: a + a.sum(), None, (np.zeros(3, np.float32),))


def test_leaves_of_other_batches_are_named():
    args = (np.zeros((2, 3), np.float32), np.zeros(4, np.float32))
    with pytest.raises(ValueError, match=r"shape \(4,\): must end with \(3,\)"):
        kernel.written(lambda a, b: (a, b), None, args)


def test_on_a_cpu_a_function_stays_itself():
    with jax.default_device(jax.devices("cpu")[0]):
        assert kernel.as_kernel(jnp.sin) is jnp.sin


@pytest.mark.parametrize(
    ("platform", "capability", "taken"),
    [("gpu", "9.0", True), ("gpu", "7.5", False), ("gpu", "gfx942", False), ("cpu", None, False)],
)
def test_kernels_are_for_gpus_that_know_their_instructions(
    monkeypatch, platform, capability, taken
):
    device = types.SimpleNamespace(platform=platform, compute_capability=capability)
    monkeypatch.setattr(jax, "devices", lambda *_: [device])
    assert kernel.on_gpu() is taken


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
def test_what_a_kernel_would_get_wrong_is_refused(function, message):
    with pytest.raises(NotImplementedError, match=message):
        kernel.written(function, None, (np.zeros(3, np.float32),))


def test_results_without_the_batch_are_named():
    with pytest.raises(ValueError, match=r"result of shape \(3,\): must end with the batch"):
        kernel.written(lambda a: (a, jnp.arange(3.0)), None, (np.zeros(5, np.float32),))
