"""Foresight: where the feet are, by Box2D's own word, and that it sees a fall before the tilt."""

import jax
import jax.numpy as jnp
import numpy as np
import official as theirs
import pytest

from hitl_jax.human import HumanParams, foresight
from hitl_jax.human.foresight import MARGIN, feet, overreach

pytestmark = theirs.needs_official


@pytest.fixture
def env():
    walker = theirs.make()
    walker.reset(seed=3)
    yield walker
    walker.close()


def test_the_feet_are_where_box2d_has_them(env):
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(40):
        seen, *_ = env.step(rng.uniform(-1.0, 1.0, 4))
        told = np.stack(feet(jnp.asarray(seen)), axis=1)
        ends = [shin.GetWorldPoint((0.0, -34 / 60)) for shin in (env.legs[1], env.legs[3])]
        hull = env.hull.position
        are = [(end.x - hull.x, end.y - hull.y) for end in ends]
        errors.append(np.abs(told - are).max())
    assert np.median(errors) < 0.005
    assert max(errors) < 0.1  # A joint gives way by some centimetres when a foot hits the ground.


def test_the_centre_of_mass_is_extrapolated_by_its_speed(env):
    seen, *_ = env.step(np.zeros(4))
    faster = jnp.asarray(seen).at[2].add(0.3)
    _, up = feet(faster)
    added = 0.3 * 50 / 6 * np.sqrt(-float(up.min()) / 10.0)
    assert float(overreach(faster) - overreach(jnp.asarray(seen))) == pytest.approx(added, rel=1e-4)


@pytest.mark.parametrize(("margin", "dangerous"), [(0.5, True), (1.5, False)])
def test_danger_begins_at_the_margin(env, margin, dangerous):
    seen, *_ = env.step(np.zeros(4))
    seen = jnp.asarray(seen)
    seen = seen.at[2].add(
        (1.0 - overreach(seen)) / (overreach(seen.at[2].add(1.0)) - overreach(seen))
    )
    part = foresight()
    params = HumanParams(extra={MARGIN: margin})
    _, judged = part.judge(part.init(), params, seen, jnp.zeros((), bool), jax.random.key(0))
    assert bool(judged) is dangerous


@pytest.mark.parametrize(("tilt", "dangerous"), [(0.46, True), (-0.46, True), (0.44, False)])
def test_who_sees_a_stumble_sees_the_tilt(env, tilt, dangerous):
    seen, *_ = env.step(np.zeros(4))
    seen = jnp.asarray(seen).at[0].set(tilt)
    part, params = foresight(), HumanParams(extra={MARGIN: 100.0})
    _, judged = part.judge(part.init(), params, seen, jnp.zeros((), bool), jax.random.key(0))
    assert bool(judged) is dangerous
