"""The task learners: what a name stands for."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import chex

from hitl_jax.learner import losses


class Learner(NamedTuple):
    """A deterministic actor-critic; its actor follows the first critic, as TD3's.

    Attributes:
        num_critics: E.
        policy_delay: critic updates to one actor update.
        smooths_target: whether noise is added to the target action.
        target: TD target from reward [B], discount [B] and the target critics' answer.
        critic_loss: what the critics minimise; see `losses.critic_loss`.
        num_quantiles: Q, how many quantiles of the return a critic answers with, [E, B, Q]; None
            where it answers with the mean, [E, B].
    """

    num_critics: int
    policy_delay: int
    smooths_target: bool
    target: Callable[[chex.Array, chex.Array, chex.Array], Any]
    critic_loss: Callable[..., tuple[chex.Array, losses.Metrics]]
    num_quantiles: int | None = None


# td3-tqc has TD3's actor, noise and delay, and the critics of "truncated quantile critics"
# (https://arxiv.org/abs/2005.04269). There each of five critics has 25 quantiles of which two are
# dropped; with two of ten each, and one dropped for each, a loss costs a tenth of that.
LEARNERS: dict[str, Learner] = {
    "ddpg": Learner(1, 1, False, losses.target_q, losses.critic_loss),
    "td3": Learner(2, 2, True, losses.target_q, losses.critic_loss),
    "td3-tqc": Learner(
        2,
        2,
        True,
        functools.partial(losses.target_quantiles, num_dropped=2),
        losses.quantile_loss,
        num_quantiles=10,
    ),
}
