"""The parts of the benchmark, and what each needs."""

from collections.abc import Callable, Sequence

from hitl_jax.benchmarks.launchers import measure_launchers
from hitl_jax.benchmarks.learner import measure_learner
from hitl_jax.benchmarks.live import measure_live
from hitl_jax.benchmarks.logs import measure_logs
from hitl_jax.benchmarks.loop import measure_loop
from hitl_jax.benchmarks.peers import measure_peers
from hitl_jax.benchmarks.pool import measure_pool
from hitl_jax.benchmarks.saves import measure_saves
from hitl_jax.benchmarks.scaling import measure_scaling
from hitl_jax.benchmarks.walkers import measure_walkers
from hitl_jax.envs import box2d
from hitl_jax.results.episode_measures import Row

PARTS: dict[str, Callable[[float], list[Row]]] = {
    "learner": measure_learner,
    "pool": measure_pool,
    "loop": measure_loop,
    "scaling": measure_scaling,
    "saves": measure_saves,
    "logs": measure_logs,
    "walkers": measure_walkers,
    "live": measure_live,
    "launchers": measure_launchers,
    "peers": measure_peers,
}
"""Each takes the seconds for one measurement, and gives the rows of its table."""

_ON_GYMNASIUM = ("pool", "peers")
_ON_BOX2D = ("loop", "scaling", "saves", "logs", "live")
"""Parts that need it: `learner` has no walkers, `walkers` tells which it did not find."""


def require_walkers(parts: Sequence[str], spell: Callable[[str], str]) -> None:
    """Refuses to begin where walkers of some parts are missing.

    Args:
        parts: some of `PARTS`.
        spell: a part as the user named it.

    Raises:
        ImportError: one line that says what to install.
    """
    for part in parts:
        if part in _ON_GYMNASIUM:
            box2d.require_gymnasium(spell(part))
        if part in _ON_BOX2D:
            box2d.require(spell(part))
