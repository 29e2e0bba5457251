"""Pools of real walkers: the only rooms that import gymnasium or EnvPool."""

import os

from hitl_jax.envs.base import Command, StepBatch, WalkerError, WalkerPool

BACKENDS = ("gymnasium", "envpool")
WALKER = "BipedalWalker-v3"

__all__ = ["BACKENDS", "WALKER", "Command", "StepBatch", "WalkerError", "WalkerPool", "make_pool"]


def make_pool(
    backend: str, num_walkers: int, num_workers: int | None = None, env_id: str = WALKER
) -> WalkerPool:
    """A pool of walkers.

    Args:
        backend: `gymnasium` (the official environment, in worker processes) or `envpool` (faster;
            its episodes cannot be seeded one by one).
        num_walkers: N.
        num_workers: processes (threads of EnvPool); one a core by default.
        env_id: any environment of the backend with flat observations and actions in [-1, 1].

    Raises:
        ValueError: for an unknown backend or a number below 1.
        ImportError: if the backend is not installed, with the extra that brings it.
        WalkerError: if a worker does not come up.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend {backend}: must be one of {', '.join(BACKENDS)}")
    if num_workers is None:
        num_workers = len(os.sched_getaffinity(0))
    for name, value in (("num_walkers", num_walkers), ("num_workers", num_workers)):
        if value < 1:
            raise ValueError(f"{name} {value}: must be at least 1")
    num_workers = min(num_workers, num_walkers)
    if backend == "envpool":
        from hitl_jax.envs.envpool_pool import EnvPoolPool

        return EnvPoolPool(env_id, num_walkers, num_workers)
    from hitl_jax.envs.gymnasium_pool import GymnasiumPool

    return GymnasiumPool(env_id, num_walkers, num_workers)
