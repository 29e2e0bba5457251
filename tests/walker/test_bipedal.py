"""Our constants and terrain equal gymnasium's, and importing them needs neither it nor Box2D."""

import subprocess
import sys

import numpy as np
import official as theirs
import pytest

from hitl_jax.envs import HARDCORE_WALKER, OUR_WALKERS
from hitl_jax.walker import bipedal, constants

_NAMES = (
    *("FPS", "SCALE", "VIEWPORT_W", "VIEWPORT_H", "MOTORS_TORQUE", "SPEED_HIP", "SPEED_KNEE"),
    *("LIDAR_RANGE", "INITIAL_RANDOM", "LEG_DOWN", "LEG_W", "LEG_H", "TERRAIN_STEP"),
    *("TERRAIN_LENGTH", "TERRAIN_HEIGHT", "TERRAIN_GRASS", "TERRAIN_STARTPAD"),
)


@theirs.needs_official
def test_constants_equal_gymnasiums():
    module = theirs.bipedal_walker
    for name in _NAMES:
        assert getattr(bipedal, name) == getattr(module, name), name
    assert bipedal.GROUND_FRICTION == module.FRICTION
    assert set(bipedal.HULL_POLY) == set(module.HULL_POLY)
    assert module.HULL_FD.density == bipedal.HULL_DENSITY
    assert {module.LEG_FD.density, module.LOWER_FD.density} == {bipedal.LEG_DENSITY}
    for ours, fixture in (
        (bipedal.HULL_FRICTION, module.HULL_FD),
        (bipedal.LEG_FRICTION, module.LEG_FD),
        (bipedal.LEG_FRICTION, module.LOWER_FD),
    ):
        assert np.float32(ours) == fixture.friction
    corners = (constants.HULL_CORNERS, *constants.LEG_CORNERS[:2])
    for ours, fixture in zip(
        corners, (module.HULL_FD, module.LEG_FD, module.LOWER_FD), strict=True
    ):
        np.testing.assert_array_equal(ours, fixture.shape.vertices)


@theirs.needs_official
def test_time_limits_equal_gymnasiums():
    import gymnasium

    limits = [gymnasium.spec(env_id).max_episode_steps for env_id in OUR_WALKERS]
    assert limits == [bipedal.MOST_STEPS, bipedal.MOST_HARDCORE_STEPS]
    assert gymnasium.spec(HARDCORE_WALKER).kwargs == {"hardcore": True}


@pytest.mark.parametrize("hardcore", [False, True])
def test_terrain_and_push_equal_gymnasiums(hardcore):
    """Seeds at both ends of their range are among them."""
    official = theirs.make(hardcore)
    kinds = set()
    for seed in (*range(100), 2**31 - 1, 2**31, 2**32 - 1):
        official.reset(seed=seed)
        rng = bipedal.random_numbers(seed)
        drawn = bipedal.draw_start(rng, hardcore)
        assert drawn.heights == official.terrain_y
        # Gymnasium's list of bodies ends with what it built first.
        shapes = [np.array(body.fixtures[0].shape.vertices) for body in official.terrain[::-1]]
        expected = [(*c.min(0), *c.max(0)) for c in shapes if len(c) == 4]
        np.testing.assert_array_equal(np.float32(drawn.boxes), np.float32(expected))
        widths = np.rint([(b.right - b.left) / bipedal.TERRAIN_STEP for b in drawn.boxes])
        kinds |= set(widths.tolist())
        # The same count was drawn: the next number is equal.
        assert rng.random() == official.np_random.random()
    assert kinds == ({1, 2, 4} if hardcore else set())


@theirs.needs_official
@pytest.mark.parametrize("seed", [0, 1, 123456789, 2**31, 2**32 - 1])
def test_the_generator_is_seeded_as_gymnasium_seeds_it(seed):
    from gymnasium.utils import seeding

    ours = bipedal.random_numbers(seed)
    expected, _ = seeding.np_random(seed)
    assert ours.bit_generator.state == expected.bit_generator.state


@pytest.mark.parametrize(
    "module",
    ["hitl_jax", "hitl_jax.walker.bipedal", "hitl_jax.envs", "hitl_jax.walker", "hitl_jax.live"],
)
def test_neither_gymnasium_nor_box2d_is_imported(module):
    code = (
        f"import sys, {module}\n"
        "found = {'gymnasium', 'Box2D'} & set(sys.modules)\n"
        "assert not found, found"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
