"""The person as a part of the team: judgement and actions come from outside, at each step anew."""

import dataclasses

import chex
import jax.numpy as jnp
from flax import struct

from hitl_jax import boundary
from hitl_jax.config import RunHyper
from hitl_jax.human.actions import ActionSource, State, scripted_walker
from hitl_jax.human.judgement import HumanParams, HumanPart
from hitl_jax.team.acting import ActingState
from hitl_jax.team.agent import Agent
from hitl_jax.team.arbiter import ArbiterState
from hitl_jax.team.packed_decision import act_or_begin
from hitl_jax.types import Behavior


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
        return Hands(jnp.zeros((), bool), jnp.zeros((num_actions,), jnp.float32), helper.init())

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


def act(
    agent: Agent,
    hyper: RunHyper,
    behavior: Behavior,
    state: ActingState,
    observation: chex.Array,
    told: Told | None,
) -> tuple[ActingState, chex.Array]:
    """One step of acting.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        behavior: what acting needs of the parameters.
        state: the acting state.
        observation: s_t, [O].
        told: what the person does; None where there is none.

    Returns:
        As `decisions.act_or_begin`.
    """
    if told is not None:
        state = tell(agent, state, told)
    return act_or_begin(agent, hyper, behavior, state, observation, jnp.asarray(True))


def see(
    agent: Agent, observation: chex.Array, boundary_now: chex.Array
) -> tuple[chex.Array, chex.Array]:
    """c_t, [], and whether it raises the alarm, bool [].

    Args:
        agent: the team.
        observation: s_t, [O].
        boundary_now: τ_t, [].
    """
    indicator = agent.indicator(observation)
    return indicator, boundary.alarm(indicator, boundary_now)
