"""A part of the human's judgement h_t, and how parts are put together.

A part is a pure function of its state, its parameters and a key, sees only what a person could see,
and works under jit, vmap and scan. All parts speak of `dangerous`, which is h_t = 0.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax

from hitl_jax.choices.options import Option, all_options
from hitl_jax.human.params import HumanParams

State = Any
"""What a part remembers: a pytree of arrays, or of plain numbers at first; see
`hitl_jax.human.caller_state`."""


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
        observation_size: of the observations that it was made for; None where any will do.
        options: traced numbers of its own, in `HumanParams.extra`.
    """

    init: Callable[[], State]
    begin_episode: Callable[[State], State]
    judge: Callable[
        [State, HumanParams, chex.Array, chex.Array, chex.PRNGKey], tuple[State, chex.Array]
    ]
    notify: Callable[..., State]
    observation_size: int | None = None
    options: tuple[Option, ...] = ()


def memoryless(
    rule: Callable[[HumanParams, chex.Array, chex.Array, chex.PRNGKey], chex.Array],
    observation_size: int | None = None,
    options: tuple[Option, ...] = (),
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

    return HumanPart(tuple, unchanged, judge, unmoved, observation_size, options)


def unchanged(state: State) -> State:
    """The state itself, for a part that forgets nothing."""
    return state


def unmoved(
    state: State, params: HumanParams, began: chex.Array, in_control: chex.Array | bool = False
) -> State:
    """The state itself, for a part to which a ruling means nothing."""
    del params, began, in_control
    return state


def chain(*parts: HumanPart) -> HumanPart:
    """Puts parts in a row: each is told the judgement of the one before.

    Args:
        *parts: in the order in which they judge; the state is a tuple of theirs.

    Raises:
        ValueError: if they were made for observations of different sizes.
    """
    sizes = {part.observation_size for part in parts if part.observation_size is not None}
    if len(sizes) > 1:
        raise ValueError(f"parts of a human made for observations of {sorted(sizes)}: must be one")

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

    return HumanPart(
        init=init,
        begin_episode=begin_episode,
        judge=judge,
        notify=notify,
        observation_size=next(iter(sizes), None),
        options=tuple(all_options(parts).values()),
    )
