"""Gymnasium's own walker, to compare with; where it is not, tests that do are skipped by name.

What passes without Box2D: PYTHONPATH=tests/without_box2d pytest tests/walker/test_walker.py ...
"""

import pytest

from hitl_jax.envs import HARDCORE_WALKER, WALKER, box2d

bipedal_walker = None
try:
    box2d.require_gymnasium("a comparison")
except ImportError as error:
    why = str(error)
else:
    from gymnasium.envs.box2d import bipedal_walker

    why = ""

needs_official = pytest.mark.skipif(bipedal_walker is None, reason=why)
needs_box2d = pytest.mark.skipif(bool(box2d.missing()), reason=f"no Box2D: {box2d.missing()}")


def make(hardcore=False):
    """Gymnasium's walker in a world of its own, without wrappers; skips a test where it is not."""
    if bipedal_walker is None:
        pytest.skip(why)
    import gymnasium

    name = HARDCORE_WALKER if hardcore else WALKER
    return gymnasium.make(name, disable_env_checker=True).unwrapped


def gait():
    """Gymnasium's scripted player, a function of the observation."""
    return bipedal_walker.BipedalWalkerHeuristics().step_heuristic
