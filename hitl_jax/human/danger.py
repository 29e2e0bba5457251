"""Danger models by name: what a simulated human holds to be dangerous.

To add one, write a `HumanPart` that looks at the observation, and register it.
"""

import chex
import jax.numpy as jnp

from hitl_jax.choices.options import options_of
from hitl_jax.choices.registry import Registry
from hitl_jax.human.indicator import WALKER_OBSERVATION, Indicator, hull_angle, weighted
from hitl_jax.human.params import HumanParams
from hitl_jax.human.part import HumanPart, memoryless

DANGER_MODELS: Registry[HumanPart] = Registry(
    "danger model",
    "danger",
    lambda value: isinstance(value, HumanPart),
    require=options_of,
)


def beyond(indicator: Indicator) -> HumanPart:
    """Danger is |indicator| ≥ tolerance, whatever was judged before.

    Args:
        indicator: maps s_t [O] to a number [] in the unit of the human's `tolerance`.
    """

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del dangerous, key
        return jnp.abs(indicator(observation)) >= params.tolerance

    return memoryless(rule, getattr(indicator, "observation_size", None))


@DANGER_MODELS.register("threshold", "|hull angle| ≥ tolerance")
def threshold() -> HumanPart:
    """Danger is |hull angle| ≥ tolerance, whatever was judged before."""
    return beyond(hull_angle)


@DANGER_MODELS.register("predictive", "|hull angle in `horizon` seconds| ≥ tolerance")
def predictive() -> HumanPart:
    """Danger is |angle + horizon · angular velocity| ≥ tolerance, whatever was judged before."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del dangerous, key
        return jnp.abs(weighted(1.0, params.horizon)(observation)) >= params.tolerance

    return memoryless(rule, WALKER_OBSERVATION)
