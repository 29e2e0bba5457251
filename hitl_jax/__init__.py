"""Human-in-the-loop actor-critic with a learned switching boundary (HITL-AC), in JAX.

The pure functions that make up a run, written for one run and ready for `vmap`; a name is loaded
when it is first used, so that importing the package is quick.
"""

import importlib
from typing import Any

_EXPORTS = {
    "hitl_jax.team.acting": ("ActingState", "Decision", "act", "begin_episode", "init_acting"),
    "hitl_jax.team.agent": (
        "Agent",
        "behavior",
        "init",
        "learn",
        "make_agent",
        "update",
        "update_boundary",
    ),
    "hitl_jax.config": ("AgentConfig", "Hyper", "Method", "RunHyper", "hyper_for"),
    "hitl_jax.envs": ("make_pool",),
    "hitl_jax.playback.trained_run": ("TrainedRun", "load_run"),
    "hitl_jax.results.all_runs": ("load_table",),
    "hitl_jax.tasks": ("Task",),
    "hitl_jax.training.rollout": ("Rollout",),
    "hitl_jax.training.run_spec": ("LoopConfig", "RunSpec"),
    "hitl_jax.types": (
        "Behavior",
        "BoundaryState",
        "BoundaryTransition",
        "LearnerState",
        "TrainState",
        "Transition",
    ),
}
_MODULE_OF = {name: module for module, names in _EXPORTS.items() for name in names}

__version__ = "0.1.0"
__all__ = list(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """Loads a public name from its room."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
