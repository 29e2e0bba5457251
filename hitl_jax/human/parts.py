"""Parts of a simulated human by name, applied to the judgement of the danger model.

To add one, write a `HumanPart` that passes on what it is told, and register it.
"""

import numbers

import chex
import jax
import jax.numpy as jnp
from flax import struct

from hitl_jax.choices.options import options_of
from hitl_jax.choices.registry import Registry
from hitl_jax.human.params import MAX_DELAY, HumanParams
from hitl_jax.human.part import HumanPart, memoryless, unmoved

DELAY, MISTAKES, LAPSES, ATTENTION = "delay", "mistakes", "lapses", "attention"

HUMAN_PARTS: Registry[HumanPart] = Registry(
    "human part",
    "human_parts",
    lambda value: isinstance(value, HumanPart),
    require=options_of,
)


@HUMAN_PARTS.register(DELAY, "judges what was seen `delay` steps ago")
def delayed(max_delay: int = MAX_DELAY, own: int | None = None) -> HumanPart:
    """Passes on the judgement of `params.delay` steps ago; safe in an episode's first steps.

    Args:
        max_delay: static length of the memory [steps]; greater delays are cut down to it.
        own: the delay of a human who has one of their own [steps], whatever `params` says.

    Raises:
        ValueError: if `max_delay` is negative.
    """
    if not isinstance(max_delay, numbers.Integral) or max_delay < 0:
        raise ValueError(f"max_delay {max_delay}: must be a whole number of at least 0")

    def judge(
        state: chex.Array,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[chex.Array, chex.Array]:
        del observation, key
        history = jnp.concatenate([jnp.reshape(dangerous, (1,)), state[:-1]])
        delay = params.delay if own is None else own
        return history, history[jnp.clip(delay, 0, max_delay)]

    return HumanPart(
        init=lambda: jnp.zeros((max_delay + 1,), bool),
        begin_episode=jnp.zeros_like,
        judge=judge,
        notify=unmoved,
    )


@HUMAN_PARTS.register(MISTAKES, "flips a judgement with `mistake_rate`")
def mistaken() -> HumanPart:
    """Flips the judgement with probability ε, at each step anew."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del observation
        return jnp.logical_xor(
            dangerous, jax.random.bernoulli(key, jnp.float32(params.mistake_rate))
        )

    return memoryless(rule)


@HUMAN_PARTS.register(LAPSES, "misses a danger with `lapse_rate`")
def lapsing() -> HumanPart:
    """Makes no judgement with probability m, at each step anew; that counts as safe."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del observation
        lapse = jax.random.bernoulli(key, jnp.float32(params.lapse_rate))
        return jnp.logical_and(dangerous, jnp.logical_not(lapse))

    return memoryless(rule)


@struct.dataclass
class Attention:
    """What limited attention remembers.

    Attributes:
        used: interventions begun in the run, int32 [].
        rest: steps for which judgement is still withheld, int32 [].
        engaged: whether the human was in control at the step before, bool [].
    """

    used: chex.Array
    rest: chex.Array
    engaged: chex.Array


@HUMAN_PARTS.register(ATTENTION, "at most so many interventions a run, and a rest between them")
def attentive() -> HumanPart:
    """At most n interventions a run and a rest between them; a judgement withheld counts as safe.

    Only an intervention that begins uses up the budget; budget and rest go on over episodes. Where
    `notify` is told of control, an intervention under way is seen through to its end, and the rest
    counts from there; where it is not, every intervention counts as one step long.
    """

    def init() -> Attention:
        zero = jnp.zeros((), jnp.int32)
        return Attention(used=zero, rest=zero, engaged=jnp.zeros((), bool))

    def begin_episode(state: Attention) -> Attention:
        return Attention(used=state.used, rest=state.rest, engaged=jnp.zeros((), bool))

    def judge(
        state: Attention,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[Attention, chex.Array]:
        del observation, key
        ready = jnp.logical_and(state.used < params.max_interventions, state.rest <= 0)
        return state, jnp.logical_and(dangerous, jnp.logical_or(state.engaged, ready))

    def notify(
        state: Attention,
        params: HumanParams,
        began: chex.Array,
        in_control: chex.Array | bool = False,
    ) -> Attention:
        rest = jnp.where(jnp.logical_or(began, in_control), params.refractory_steps, state.rest - 1)
        return Attention(
            used=state.used + jnp.asarray(began, jnp.int32),
            rest=jnp.maximum(rest, 0).astype(jnp.int32),
            engaged=jnp.asarray(in_control, bool),
        )

    return HumanPart(init=init, begin_episode=begin_episode, judge=judge, notify=notify)
