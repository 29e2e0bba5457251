"""Which stage plays a pool's walkers."""

from hitl_jax.envs import WalkerPool
from hitl_jax.team.agent import Agent
from hitl_jax.training.host_stage import HostStage
from hitl_jax.training.learner_queue import LearnerQueue
from hitl_jax.training.stage import Stage


def make_stage(agent: Agent, pool: WalkerPool, learner: LearnerQueue) -> Stage:
    """The device's stage for walkers that are on one, else the host's.

    Args:
        agent: the team.
        pool: the walkers.
        learner: of the batch.
    """
    if hasattr(pool, "blocks"):  # Of a JaxPool.
        from hitl_jax.training.device_stage import DeviceStage

        return DeviceStage(agent, pool, learner)  # type: ignore[arg-type]
    return HostStage(agent, pool, learner)
