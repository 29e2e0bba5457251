"""The person as a part of the team: judgement and actions come from outside, at each step anew."""

import dataclasses

import chex
import jax.numpy as jnp
from flax import struct

from hitl_jax.acting import ActingState
from hitl_jax.agent import Agent
from hitl_jax.arbiter import ArbiterState
from hitl_jax.human import HumanParams, HumanPart
from hitl_jax.human_actions import ActionSource, State, scripted_walker


@struct.dataclass
class Told:
    """What a person does at one step.

    Attributes:
        dangerous: the judgement h_t = 0, bool [].
        takes: the person has the controls, whatever the alarm says, bool [].
        assisted: an assistant walks in the person's place, bool [].
        action: what the person's keys ask of hips and knees, [A].
        boundary: τ_t, which a label that came late may have changed, [].
    """

    dangerous: chex.Array
    takes: chex.Array
    assisted: chex.Array
    action: chex.Array
    boundary: chex.Array


@struct.dataclass
class Hands:
    """What the source of the person's actions remembers.

    Attributes:
        assisted: as in `Told`.
        action: as in `Told`.
        assistant: the assistant's own state.
    """

    assisted: chex.Array
    action: chex.Array
    assistant: State


def judge() -> HumanPart:
    """The judgement that was told; its state is that, bool []."""

    def judged(
        state: State,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[State, chex.Array]:
        del params, observation, dangerous, key
        return state, state

    return HumanPart(
        init=lambda: jnp.zeros((), bool),
        begin_episode=lambda state: state,
        judge=judged,
        notify=lambda state, *_: state,
    )


def hands(num_actions: int, assistant: ActionSource | None = None) -> ActionSource:
    """The actions that were told, or an assistant's.

    Args:
        num_actions: A.
        assistant: walks where the person asks for it; by default gymnasium's scripted walker.
    """
    helper = assistant or scripted_walker()

    def init() -> Hands:
        return Hands(jnp.zeros((), bool), jnp.zeros((num_actions,)), helper.init())

    def act(state: Hands, observation: chex.Array, key: chex.PRNGKey) -> tuple[Hands, chex.Array]:
        assistant_state, action = helper.act(state.assistant, observation, key)
        chosen = jnp.where(state.assisted, action, state.action)
        return dataclasses.replace(state, assistant=assistant_state), chosen

    return ActionSource(
        init=init,
        begin_episode=lambda state: dataclasses.replace(
            state, assistant=helper.begin_episode(state.assistant)
        ),
        act=act,
    )


def tell(agent: Agent, state: ActingState, told: Told) -> ActingState:
    """Acting of a team with `judge` and `hands`, told what the person does at the next step.

    Control that was taken goes on by the arbiter's own rule, since who is in control judges the
    state to be dangerous; it ends when the person lets go, however short it was.
    """
    memory = state.arbiter
    if agent.config.intervention == "takeover":
        memory = ArbiterState(hold=jnp.zeros_like(memory.hold), in_control=told.takes)
    return dataclasses.replace(
        state,
        boundary=told.boundary,
        human=told.dangerous | told.takes,
        source=dataclasses.replace(state.source, assisted=told.assisted, action=told.action),
        arbiter=memory,
    )
