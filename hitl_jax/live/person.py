"""The person as the human of a team: judgement and actions are inputs of each step.

All of it is pure; `live_person` keeps what the person said.
"""

import dataclasses

import chex
import jax.numpy as jnp
from flax import struct

from hitl_jax import boundary
from hitl_jax.arbiter import ArbiterState
from hitl_jax.config import RunHyper
from hitl_jax.human.actions import ActionSource, State, scripted_walker
from hitl_jax.human.judgement import HumanParams, HumanPart
from hitl_jax.team.acting import ActingState
from hitl_jax.team.agent import Agent
from hitl_jax.team.packed_decision import act_or_begin
from hitl_jax.types import Behavior


@struct.dataclass
class PersonInput:
    """What a person does at one step.

    Attributes:
        dangerous: the judgement h_t = 0, bool [].
        in_control: whether the person has control, with or without an alarm, bool [].
        assisted: whether an assistant acts in the person's place, bool [].
        action: the person's action, [A].
        boundary: τ_t, which a late label may have changed, [].
    """

    dangerous: chex.Array
    in_control: chex.Array
    assisted: chex.Array
    action: chex.Array
    boundary: chex.Array


@struct.dataclass
class ActionsState:
    """The state of `actions`.

    Attributes:
        assisted: as in `PersonInput`.
        action: as in `PersonInput`.
        assistant: the assistant's own state.
    """

    assisted: chex.Array
    action: chex.Array
    assistant: State


def judge() -> HumanPart:
    """A human whose judgement is its state, h_t = 0 as bool []; `with_input` sets it."""

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


def actions(num_actions: int, assistant: ActionSource | None = None) -> ActionSource:
    """A human whose actions are those of `with_input`, or an assistant's.

    Args:
        num_actions: A.
        assistant: acts where the person asks for it; by default gymnasium's scripted walker.
    """
    helper = assistant or scripted_walker()

    def init() -> ActionsState:
        return ActionsState(
            jnp.zeros((), bool), jnp.zeros((num_actions,), jnp.float32), helper.init()
        )

    def act(
        state: ActionsState, observation: chex.Array, key: chex.PRNGKey
    ) -> tuple[ActionsState, chex.Array]:
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


def with_input(agent: Agent, state: ActingState, said: PersonInput) -> ActingState:
    """Puts what the person does into the acting state of a team with `judge` and `actions`.

    The arbiter keeps control with a person who has it, since they judge the state to be dangerous.
    Control ends when the person lets go, without a minimum time.
    """
    memory = state.arbiter
    if agent.config.intervention == "takeover":
        memory = ArbiterState(hold=jnp.zeros_like(memory.hold), in_control=said.in_control)
    return dataclasses.replace(
        state,
        boundary=said.boundary,
        human=said.dangerous | said.in_control,
        source=dataclasses.replace(state.source, assisted=said.assisted, action=said.action),
        arbiter=memory,
    )


def act(
    agent: Agent,
    hyper: RunHyper,
    behavior: Behavior,
    state: ActingState,
    observation: chex.Array,
    said: PersonInput | None,
) -> tuple[ActingState, chex.Array]:
    """One step of acting.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        behavior: what acting needs of the parameters.
        state: the acting state.
        observation: s_t, [O].
        said: what the person does; None where there is no person.

    Returns:
        As `packed_decision.act_or_begin`.
    """
    if said is not None:
        state = with_input(agent, state, said)
    return act_or_begin(agent, hyper, behavior, state, observation, jnp.asarray(True))


def indicator_and_alarm(
    agent: Agent, params: Behavior, observation: chex.Array, boundary_now: chex.Array
) -> tuple[chex.Array, chex.Array]:
    """The indicator c_t, [], and whether it raises the alarm, bool [].

    Args:
        agent: the team.
        params: what acting needs of the run's parameters.
        observation: s_t, [O].
        boundary_now: τ_t, [].
    """
    indicator = agent.safety_indicator(params, observation)
    return indicator, boundary.alarm(indicator, boundary_now)
