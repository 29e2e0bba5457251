"""BipedalWalker-v3 in JAX: pure functions that agree with Box2D step by step, on any device.

`reset(key)` and `step(walker, action)` are in `env`, which is imported when one of its names is
first used: worker processes of Box2D's walkers import `bipedal` from here and need no JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hitl_jax.walker.env import (
        ACTION_SIZE,
        OBSERVATION_SIZE,
        Step,
        Walker,
        new_walker,
        new_walker_on,
        reset,
        step,
    )

__all__ = [
    "ACTION_SIZE",
    "OBSERVATION_SIZE",
    "Step",
    "Walker",
    "new_walker",
    "new_walker_on",
    "reset",
    "step",
]


def __getattr__(name: str) -> Any:
    """Imports a public name from `env`."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("hitl_jax.walker.env"), name)
