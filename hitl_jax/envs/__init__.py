"""Pools of walkers by backend: gymnasium, Box2D and EnvPool are imported here alone, and lazily.

To add a backend, write a function that gives a `WalkerPool` and register it.
"""

import operator
import sys

from hitl_jax.choices.registry import Registry, having
from hitl_jax.envs import box2d
from hitl_jax.envs.base import Command, StepBatch, WalkerPool
from hitl_jax.errors import Unplayable, WalkerError
from hitl_jax.xla.cores import num_cores

BACKENDS: Registry[WalkerPool] = Registry(
    "walker pool",
    "backend",
    having("num_walkers", "observation_size", "action_size", "seedable", "step", "close"),
    made_once=False,
    passes=(ValueError, ImportError, OSError),
)
"""Each is made with `num_walkers`, `num_workers`, `env_id` and `seed`; see `make_pool`."""
WALKER = "BipedalWalker-v3"
HARDCORE_WALKER = "BipedalWalkerHardcore-v3"
OUR_WALKERS = (WALKER, HARDCORE_WALKER)
"""What backends `lean` and `jax` play."""

__all__ = [
    "BACKENDS",
    "HARDCORE_WALKER",
    "OUR_WALKERS",
    "WALKER",
    "Command",
    "StepBatch",
    "WalkerError",
    "WalkerPool",
    "default_backend",
    "host_backend",
    "make_pool",
    "num_cores",
    "require_backend",
]


def default_backend(env_id: str = WALKER) -> str:
    """As `host_backend`, but `jax` where that is `lean` and Box2D cannot be imported."""
    backend = host_backend(env_id)
    return "jax" if backend == "lean" and box2d.missing() is not None else backend


def host_backend(env_id: str = WALKER) -> str:
    """`lean` of `OUR_WALKERS`, else `gymnasium`."""
    return "lean" if env_id in OUR_WALKERS else "gymnasium"


def require_backend(backend: str, env_id: str = WALKER) -> None:
    """Notices before any work that what a backend's walkers stand on is missing.

    Args:
        backend: one of `BACKENDS`.
        env_id: one of `OUR_WALKERS`, or any other, of which nothing is known.

    Raises:
        ImportError: one line that says what to install.
    """
    if env_id in OUR_WALKERS:
        if backend == "lean":
            box2d.require("backend 'lean'")
        elif backend == "gymnasium":
            box2d.require_gymnasium("backend 'gymnasium'")


def make_pool(
    backend: str,
    num_walkers: int,
    num_workers: int | None = None,
    env_id: str = WALKER,
    *,
    seed: int = 0,
) -> WalkerPool:
    """Makes a pool of walkers; close it, or use it in a `with`.

    A pool's actions are in [-1, 1], whatever the environment's bounds are: they are scaled onto
    them. Observations become float32.

    Args:
        backend: `gymnasium` (the official environment in worker processes; episodes are seeded),
            `lean` (equal to it bit for bit, in half the time), `envpool` (its Box2D is another
            version and episodes cannot be seeded), `jax` (`hitl_jax.walker`, which agrees with it
            up to rounding), or `module:name` of a function of your own with these arguments by
            name. `lean` and `jax` play `OUR_WALKERS` only.
        num_walkers: N, a whole number.
        num_workers: processes, or threads of `envpool`, or CPU devices of `jax`, at most N are
            used; by default one for each core that this process may use.
        env_id: an environment with flat observations and flat continuous actions of finite bounds,
            or `module:name` of a `hitl_jax.tasks.Task`.
            With `gymnasium` one of your own is `module:Name-v0`: the worker processes import the
            module, which registers it, and each episode is played in a new environment. One whose
            episodes do not follow from their seeds and actions (running statistics) is refused.
        seed: seed of all EnvPool's episodes together, in [0, 2³¹). The others do not read it: there
            each RESET brings a seed.

    Raises:
        ValueError: if an argument is not allowed; one line with its name, value and what is.
        ImportError: if EnvPool or Box2D is needed and missing; one line that says what to install.
        WalkerError: if a worker process does not come up.
    """
    BACKENDS.check(backend)
    if num_workers is None:
        num_workers = num_cores()
    num_walkers = _whole("num_walkers", num_walkers, 1)
    num_workers = min(_whole("num_workers", num_workers, 1), num_walkers)
    seed = _whole("seed", seed, 0, 2**31 - 1)
    if not isinstance(env_id, str):
        raise ValueError(f"env_id {env_id!r}: must be a string")
    if _in_worker():
        raise Unplayable(
            env_id,
            "a walker's process makes no pools; the module that registers an environment must not "
            "make one when it is imported: put that under `if __name__ == '__main__':`",
        )
    from hitl_jax.tasks import task_of  # It imports JAX, which a walker's process does without.

    task = task_of(env_id)
    pool = BACKENDS.make(
        backend, num_walkers=num_walkers, num_workers=num_workers, env_id=task.env_id, seed=seed
    )
    if backend in BACKENDS:
        pool.ends = task.ends
    return pool


@BACKENDS.register("lean", "equal to gymnasium's walker bit for bit, and twice as fast")
def _lean(num_walkers: int, num_workers: int, env_id: str, seed: int) -> WalkerPool:
    del seed
    _require_ours("lean", env_id)
    return _workers("lean", num_walkers, num_workers, env_id)


@BACKENDS.register("gymnasium", "the official one, in worker processes")
def _gymnasium(num_walkers: int, num_workers: int, env_id: str, seed: int) -> WalkerPool:
    del seed
    return _workers("gymnasium", num_walkers, num_workers, env_id)


@BACKENDS.register("envpool", "its terrain cannot be seeded; needs the extra `fast`")
def _envpool(num_walkers: int, num_workers: int, env_id: str, seed: int) -> WalkerPool:
    from hitl_jax.envs.envpool_pool import EnvpoolPool

    return EnvpoolPool(env_id, num_walkers, num_workers, seed=seed)


@BACKENDS.register("jax", "our own, compiled, which agrees with them up to rounding")
def _jax(num_walkers: int, num_workers: int, env_id: str, seed: int) -> WalkerPool:
    del seed
    _require_ours("jax", env_id)
    from hitl_jax.envs.jax_pool import JaxPool

    return JaxPool(num_walkers, num_workers, env_id == HARDCORE_WALKER)


def _workers(backend: str, num_walkers: int, num_workers: int, env_id: str) -> WalkerPool:
    require_backend(backend, env_id)
    from hitl_jax.envs.worker_pool import WorkerPool

    return WorkerPool(backend, env_id, num_walkers, num_workers)


def _require_ours(backend: str, env_id: str) -> None:
    if env_id not in OUR_WALKERS:
        raise ValueError(
            f"env_id {env_id!r}: must be one of {', '.join(OUR_WALKERS)} with backend {backend!r}; "
            "backend 'gymnasium' takes any"
        )


def _whole(name: str, value: int, least: int, most: int | None = None) -> int:
    """A whole number within bounds; NumPy's are allowed too."""
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or number < least or (most is not None and number > most):
        upper = "" if most is None else f" and at most {most}"
        raise ValueError(f"{name} {value!r}: must be a whole number of at least {least}{upper}")
    return number


def _in_worker() -> bool:
    """Whether this is a worker's process: it imports modules that register environments."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    return spec is not None and spec.name == "hitl_jax.envs.worker"
