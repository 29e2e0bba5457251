"""A human who takes the controls whenever they are called, and gives them back as they judge."""

from typing import Any

import chex
import jax.numpy as jnp

from hitl_jax.human.params import HumanParams
from hitl_jax.human.part import HumanPart


def trusting(human: HumanPart) -> HumanPart:
    """Somebody who agrees with every alarm: what they are called by decides when they act.

    Args:
        human: by whose judgement a takeover ends.
    """

    def judge(
        state: tuple[Any, chex.Array],
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[tuple[Any, chex.Array], chex.Array]:
        own, in_control = state
        own, sees_danger = human.judge(own, params, observation, dangerous, key)
        return (own, in_control), jnp.asarray(sees_danger, bool) | ~in_control

    def notify(
        state: tuple[Any, chex.Array],
        params: HumanParams,
        began: chex.Array,
        in_control: chex.Array | bool = False,
    ) -> tuple[Any, chex.Array]:
        own = human.notify(state[0], params, began, in_control)
        return own, jnp.asarray(in_control, bool)

    return human._replace(
        init=lambda: (human.init(), jnp.zeros((), bool)),
        begin_episode=lambda state: (human.begin_episode(state[0]), jnp.zeros((), bool)),
        judge=judge,
        notify=notify,
    )
