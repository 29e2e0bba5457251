"""Which examiner a pool of walkers gets, and how many walkers it needs."""

from hitl_jax.envs import WalkerPool
from hitl_jax.evaluation.device import DeviceExaminer, num_walkers
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import Examiner
from hitl_jax.team.agent import Agent

_TESTS = 3
"""Of a run at most: alone, assisted, and its snapshots."""


def num_test_walkers(backend: str, episodes: int, num_runs: int, num_devices: int) -> int:
    """Walkers for the tests of a batch of runs.

    Args:
        backend: of the walkers.
        episodes: of one test.
        num_runs: how many runs will be tested.
        num_devices: CPU devices that backend `jax` shares its walkers out over.
    """
    if backend != "jax":
        return episodes
    return num_walkers(_TESTS * num_runs * episodes, num_devices)


def make_examiner(agent: Agent, pool: WalkerPool, episodes: int) -> Examiner:
    """The device's examiner for walkers that are on one, else the host's.

    Args:
        agent: the team as it trained.
        pool: of `num_test_walkers`.
        episodes: of one test.
    """
    if hasattr(pool, "blocks"):  # Of a JaxPool.
        return DeviceExaminer(agent, pool, episodes)  # type: ignore[arg-type]
    return HostExaminer(agent, pool)
