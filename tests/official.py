"""Gymnasium's own walker, to compare with; tests that do are skipped, by reason, where it is not.

To see what passes without Box2D: PYTHONPATH=tests/without_box2d pytest tests/test_walker.py ...
"""

import pytest

from hitl_jax.envs import HARDCORE_WALKER, WALKER, box2d

bipedal_walker = None
try:
    box2d.require_gymnasium("the comparison")
except ImportError as error:
    _why = str(error)
else:
    from gymnasium.envs.box2d import bipedal_walker

    _why = ""

needs_official = pytest.mark.skipif(bipedal_walker is None, reason=_why)
needs_box2d = pytest.mark.skipif(box2d.missing() is not None, reason=f"no Box2D: {box2d.missing()}")


def make(hardcore=False):
    """Gymnasium's walker in a world of its own, without wrappers."""
    import gymnasium

    name = HARDCORE_WALKER if hardcore else WALKER
    return gymnasium.make(name, disable_env_checker=True).unwrapped
