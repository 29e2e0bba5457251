"""The human's judgement h_t of one run, put together from parts like an optax chain.

    danger ∘ reaction delay ∘ mistakes ∘ lapses ∘ limited attention

Each part is told what the parts before it judged and passes on its own judgement. All speak of
`dangerous`, which is h_t = 0. A part sees only what a person could see, is a pure function of its
state, its parameters and a key, and works under jit, vmap and scan. A recorded log (`recorded`) or
a person at the keyboard is one more `HumanPart`.
"""

import functools
import numbers
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from flax import struct

from hitl_jax.choices.checks import require_that, require_up_to
from hitl_jax.human.indicator import hull_angle, weighted

MAX_DELAY = 32
"""Longest reaction delay unless another is asked for, in steps."""

UNLIMITED = 2**31 - 1
"""A budget of interventions that no run uses up: the greatest int32."""

State = Any
"""What a part remembers: a pytree of arrays, or of plain numbers at first; see
`hitl_jax.human.caller_state`."""


@struct.dataclass
class HumanParams:
    """Traced parameters of a simulated human; each a scalar, or [R] for a batch of runs.

    Attributes:
        tolerance: hull angle from which a state is dangerous [rad].
        horizon: how far ahead a `predictive` human looks [s].
        delay: reaction delay [steps; 50 are one second, a person needs 10 to 25].
        mistake_rate: ε, probability that a judgement is flipped, at each step [1].
        lapse_rate: m, probability that no judgement is made, at each step [1].
        max_interventions: interventions that the human has patience for in a run [count]. A
            judgement that is withheld counts as safe, and so loosens a boundary that raises alarms.
        refractory_steps: rest after an intervention before the next [steps].
    """

    tolerance: float = 0.45
    horizon: float = 0.2
    delay: int = 0
    mistake_rate: float = 0.0
    lapse_rate: float = 0.0
    max_interventions: int = UNLIMITED
    refractory_steps: int = 0


def validate_human_params(params: HumanParams, max_delay: int = MAX_DELAY) -> None:
    """Checks host values before any work starts.

    Args:
        params: scalars, not yet on a device.
        max_delay: longest delay that the human was made for [steps].

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    require_that(
        "human.tolerance", params.tolerance, lambda value: value > 0, "a finite number above 0"
    )
    require_that(
        "human.horizon", params.horizon, lambda value: value >= 0, "a finite number of at least 0"
    )
    for name in ("mistake_rate", "lapse_rate"):
        require_up_to(f"human.{name}", getattr(params, name), 1)
    limits = {"delay": max_delay, "max_interventions": UNLIMITED, "refractory_steps": UNLIMITED}
    for name, most in limits.items():
        require_up_to(f"human.{name}", getattr(params, name), most, whole=True)


class HumanPart(NamedTuple):
    """One part of a human, or a whole one.

    Attributes:
        init: () to the state at the start of a run.
        begin_episode: state to the state at the start of an episode.
        judge: (state, params, observation [O], dangerous bool [], key) to (state, dangerous). It is
            called once a step, told what the parts before judged, and consumes the key.
        notify: (state, params, began bool [], in_control bool [] = False) to state; called once a
            step, after the ruling. `began`: an intervention began at this step. `in_control`: u_t,
            the human is in control at this step; only `attentive` asks for it.
    """

    init: Callable[[], State]
    begin_episode: Callable[[State], State]
    judge: Callable[
        [State, HumanParams, chex.Array, chex.Array, chex.PRNGKey], tuple[State, chex.Array]
    ]
    notify: Callable[..., State]


def threshold() -> HumanPart:
    """Danger is |hull angle| ≥ tolerance, whatever was judged before."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del dangerous, key
        return jnp.abs(hull_angle(observation)) >= params.tolerance

    return _memoryless(rule)


def predictive() -> HumanPart:
    """Danger is |angle + horizon · angular velocity| ≥ tolerance, whatever was judged before."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del dangerous, key
        return jnp.abs(weighted(1.0, params.horizon)(observation)) >= params.tolerance

    return _memoryless(rule)


DANGER_MODELS: dict[str, Callable[[], HumanPart]] = {
    "threshold": threshold,
    "predictive": predictive,
}


def recorded(dangerous: chex.Array) -> HumanPart:
    """Plays back a log, one entry a step, over all episodes of a run; safe past its end.

    Args:
        dangerous: h_t = 0 of step t of the run, bool [T].

    Raises:
        ValueError: if the log is not of type bool and rank 1.
    """
    log = jnp.asarray(dangerous)
    if log.dtype != bool or log.ndim != 1:
        raise ValueError(f"log of judgements {log.dtype}{list(log.shape)}: must be bool[T]")
    num_steps = log.shape[0]
    log = jnp.append(log, False)

    def judge(
        state: chex.Array,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[chex.Array, chex.Array]:
        del params, observation, dangerous, key
        return jnp.minimum(state + 1, num_steps), log[state]

    return HumanPart(
        init=lambda: jnp.zeros((), jnp.int32),
        begin_episode=_unchanged,
        judge=judge,
        notify=_unmoved,
    )


def delayed(max_delay: int = MAX_DELAY) -> HumanPart:
    """Passes on the judgement of `params.delay` steps ago; safe in an episode's first steps.

    Args:
        max_delay: static length of the memory [steps]; greater delays are cut down to it.

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
        return history, history[jnp.clip(params.delay, 0, max_delay)]

    return HumanPart(
        init=lambda: jnp.zeros((max_delay + 1,), bool),
        begin_episode=jnp.zeros_like,
        judge=judge,
        notify=_unmoved,
    )


def mistaken() -> HumanPart:
    """Flips the judgement with probability ε, at each step anew."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del observation
        return jnp.logical_xor(
            dangerous, jax.random.bernoulli(key, jnp.float32(params.mistake_rate))
        )

    return _memoryless(rule)


def lapsing() -> HumanPart:
    """Makes no judgement with probability m, at each step anew; that counts as safe."""

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del observation
        lapse = jax.random.bernoulli(key, jnp.float32(params.lapse_rate))
        return jnp.logical_and(dangerous, jnp.logical_not(lapse))

    return _memoryless(rule)


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


def chain(*parts: HumanPart) -> HumanPart:
    """Puts parts in a row: each is told the judgement of the one before.

    Args:
        *parts: in the order in which they judge; the state is a tuple of theirs.
    """

    def init() -> State:
        return tuple(part.init() for part in parts)

    def begin_episode(state: State) -> State:
        return tuple(part.begin_episode(own) for part, own in zip(parts, state, strict=True))

    def judge(
        state: State,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[State, chex.Array]:
        after = []
        keys = jax.random.split(key, len(parts))
        for part, own, own_key in zip(parts, state, keys, strict=True):
            own, dangerous = part.judge(own, params, observation, dangerous, own_key)
            after.append(own)
        return tuple(after), dangerous

    def notify(
        state: State,
        params: HumanParams,
        began: chex.Array,
        in_control: chex.Array | bool = False,
    ) -> State:
        return tuple(
            part.notify(own, params, began, in_control)
            for part, own in zip(parts, state, strict=True)
        )

    return HumanPart(init=init, begin_episode=begin_episode, judge=judge, notify=notify)


@functools.cache
def simulated_human(danger: str = "threshold", max_delay: int = MAX_DELAY) -> HumanPart:
    """Danger ∘ delay ∘ mistakes ∘ lapses ∘ attention, in that order.

    Args:
        danger: a name in `DANGER_MODELS`.
        max_delay: longest delay [steps].

    Raises:
        ValueError: one line, for an unknown model or a negative delay.
    """
    if danger not in DANGER_MODELS:
        raise ValueError(f"danger {danger}: must be one of {', '.join(DANGER_MODELS)}")
    parts = (DANGER_MODELS[danger](), delayed(max_delay), mistaken(), lapsing(), attentive())
    return chain(*parts)


def outcome_dangerous(fell: chex.Array, k: chex.Numeric) -> chex.Array:
    """Danger judged by outcome: the walker falls within k steps. For measuring only.

    State s_t is dangerous if one of the steps t, t + 1, ..., t + k − 1 ends in a fall.

    Args:
        fell: whether the step taken in s_t ended in a fall, bool [T], of one whole episode.
        k: steps to look ahead; 0 or less finds no danger.

    Returns:
        Whether s_t was dangerous, bool [T].
    """
    chex.assert_rank(fell, 1)
    falls_before = jnp.append(jnp.int32(0), jnp.cumsum(fell, dtype=jnp.int32))
    num_steps = fell.shape[0]
    start = jnp.arange(num_steps, dtype=jnp.int32)
    end = jnp.clip(start + k, start, num_steps)
    return falls_before[end] > falls_before[start]


def _memoryless(
    rule: Callable[[HumanParams, chex.Array, chex.Array, chex.PRNGKey], chex.Array],
) -> HumanPart:
    """A part without state; `rule` maps (params, observation, dangerous, key) to dangerous."""

    def judge(
        state: State,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[State, chex.Array]:
        return state, rule(params, observation, dangerous, key)

    return HumanPart(init=tuple, begin_episode=_unchanged, judge=judge, notify=_unmoved)


def _unchanged(state: State) -> State:
    return state


def _unmoved(
    state: State, params: HumanParams, began: chex.Array, in_control: chex.Array | bool = False
) -> State:
    del params, began, in_control
    return state
