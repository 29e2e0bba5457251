"""BipedalWalker-v3 in JAX: pure functions that agree with Box2D step by step, on any device.

`reset(key)` and `step(walker, action)` are in `env`. They are loaded when they are first asked for:
a worker process of Box2D's walkers reads `bipedal` here, and needs no JAX.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hitl_jax.walker.env import (
        ACTION_SIZE,
        OBSERVATION_SIZE,
        Step,
        Walker,
        made,
        made_on,
        reset,
        step,
    )

__all__ = ["ACTION_SIZE", "OBSERVATION_SIZE", "Step", "Walker", "made", "made_on", "reset", "step"]


def __getattr__(name: str) -> Any:
    """Loads a public name from `env`."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("hitl_jax.walker.env"), name)
