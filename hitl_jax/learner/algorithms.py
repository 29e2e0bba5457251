"""The task learners by name. To add one: implement `TaskLearner` and register it."""

from typing import Any

import chex

from hitl_jax.choices.registry import Registry, having
from hitl_jax.learner import losses
from hitl_jax.learner.deterministic import DeterministicActorCritic
from hitl_jax.learner.human_data import HUMAN_DATA
from hitl_jax.learner.task_learner import NEEDS, Sizes, TaskLearner, require_usable

LEARNERS: Registry[TaskLearner] = Registry(
    "task learner", "learner", having(*NEEDS), require=require_usable
)
"""Each is made from an `AgentConfig`."""


def _deterministic(config: Sizes, **choices: Any) -> DeterministicActorCritic:
    return DeterministicActorCritic(
        observation_size=config.observation_size,
        action_size=config.action_size,
        hidden_sizes=config.hidden_sizes,
        layer_norm=config.layer_norm,
        matmul_precision=config.matmul_precision,
        human_data=HUMAN_DATA.make(config.human_data),
        **choices,
    )


@LEARNERS.register("ddpg", "one critic, plain target")
def ddpg(config: Sizes) -> DeterministicActorCritic:
    """DDPG (https://arxiv.org/abs/1509.02971)."""
    return _deterministic(
        config,
        num_critics=1,
        policy_delay=1,
        smooths_target=False,
        target=losses.target_q,
        critic_loss=losses.critic_loss,
    )


@LEARNERS.register("td3", "two critics, smoothed target, delayed actor")
def td3(config: Sizes) -> DeterministicActorCritic:
    """TD3 (https://arxiv.org/abs/1802.09477)."""
    return _deterministic(
        config,
        num_critics=2,
        policy_delay=2,
        smooths_target=True,
        target=losses.target_q,
        critic_loss=losses.critic_loss,
    )


def truncated_target(
    reward: chex.Array, discount: chex.Array, next_quantiles: chex.Array
) -> losses.Atoms:
    """TD targets without the two largest quantiles; see `losses.target_quantiles`.

    In the paper of TQC each of five critics has 25 quantiles of which two are dropped; with two
    critics of ten each, and one dropped for each, a loss costs a tenth of that.
    """
    return losses.target_quantiles(reward, discount, next_quantiles, num_dropped=2)


@LEARNERS.register("td3-tqc", "as `td3`, the critics learn quantiles of the return")
def td3_tqc(config: Sizes) -> DeterministicActorCritic:
    """TD3's actor, noise and delay, with the critics of TQC (https://arxiv.org/abs/2005.04269)."""
    return _deterministic(
        config,
        num_critics=2,
        policy_delay=2,
        smooths_target=True,
        target=truncated_target,
        critic_loss=losses.quantile_loss,
        num_quantiles=10,
    )
