"""What one run does at a step: noise, boundary, alarm, arbiter, action. The caller vmaps it."""

import dataclasses
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
from flax import struct

from hitl_jax import boundary
from hitl_jax.arbiter import Ruling, Situation, Takeover
from hitl_jax.boundary.carry import first_carry, next_carry
from hitl_jax.config import RunHyper, as_float32, traced
from hitl_jax.human import actions, caller_state
from hitl_jax.team.parts import Agent
from hitl_jax.team.warmup import acts_at_random
from hitl_jax.types import Behavior, Params

_HUMAN, _SOURCE, _INTERVENTION = "the human", "the human's actions", "the intervention"


@struct.dataclass
class ActingState:
    """What acting remembers in one run.

    Attributes:
        key: typed PRNG key of the run's acting, [].
        steps: environment steps taken, int32 [].
        episodes: episodes begun, int32 [].
        noise: the action noise in units of its standard deviation, [A].
        boundary: the boundary source's carry, [] or [K].
        human: the human's state.
        source: the state of the human's actions.
        arbiter: the intervention's state.
    """

    key: chex.PRNGKey
    steps: chex.Array
    episodes: chex.Array
    noise: chex.Array
    boundary: chex.Array
    human: chex.ArrayTree
    source: chex.ArrayTree
    arbiter: chex.ArrayTree


@struct.dataclass
class Decision:
    """What one run decided at one step.

    Attributes:
        action: the action to execute, [A].
        control: u_t, bool [].
        began: whether an intervention began, bool [].
        human_action: whether `action` is the human's, bool [].
        human_reset: whether the human ends the episode after this step, bool [].
        alarmed: C, bool [].
        dangerous: h_t = 0, bool [].
        boundary: τ_t, [].
        next_boundary: τ_{t+1} of line 8, [].
        boundary_reward: r'_t, [].
        explores: whether the machine acts with noise or at random, where some episodes have no
            noise, bool [].
    """

    action: chex.Array
    control: chex.Array
    began: chex.Array
    human_action: chex.Array
    human_reset: chex.Array
    alarmed: chex.Array
    dangerous: chex.Array
    boundary: chex.Array
    next_boundary: chex.Array
    boundary_reward: chex.Array
    explores: chex.Array


def init_acting(agent: Agent, hyper: RunHyper, key: chex.PRNGKey) -> ActingState:
    """Acting at the first step of a run.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        key: consumed, [].
    """
    initial = jnp.asarray(hyper.initial_boundary, jnp.float32)
    return ActingState(
        key=key,
        steps=jnp.zeros((), jnp.int32),
        episodes=jnp.zeros((), jnp.int32),
        noise=jnp.zeros((agent.config.action_size,), jnp.float32),
        boundary=first_carry(agent.boundary_source, initial),
        human=caller_state.begun(_HUMAN, agent.human.init()),
        source=caller_state.begun(_SOURCE, agent.source.init()),
        arbiter=caller_state.begun(_INTERVENTION, agent.intervention.init()),
    )


def begin_episode(agent: Agent, state: ActingState) -> ActingState:
    """Resets what belongs to an episode; boundary, step count and attention carry over."""
    return dataclasses.replace(
        state,
        episodes=state.episodes + 1,
        noise=jnp.zeros_like(state.noise),
        human=caller_state.kept(_HUMAN, agent.human.begin_episode(state.human), state.human),
        source=caller_state.kept(_SOURCE, agent.source.begin_episode(state.source), state.source),
        arbiter=caller_state.begun(_INTERVENTION, agent.intervention.init()),
    )


def act(
    agent: Agent,
    hyper: RunHyper,
    params: Behavior,
    state: ActingState,
    observation: chex.Array,
) -> tuple[ActingState, Decision]:
    """One step of Algorithm 1 up to the plant: lines 4 to 8, and the choice of action.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        params: what acting needs of the run's parameters.
        state: the acting state.
        observation: s_t, [O].

    Returns:
        The next acting state and the decision.
    """
    chex.assert_shape(observation, (agent.config.observation_size,))
    hyper, observation = traced(agent.with_extra(hyper)), as_float32(observation)
    key, noise_key, warmup_key, boundary_key, human_key, source_key = jax.random.split(state.key, 6)

    noise, action = _explore(agent, hyper, params.actor, state, observation, noise_key)
    machine_action = _or_random(hyper, state, action, warmup_key)
    boundary_now = _boundary(agent, hyper, params.boundary_actor, state, observation, boundary_key)
    human_state, dangerous = agent.human.judge(
        state.human, hyper.human, observation, jnp.zeros((), bool), human_key
    )
    indicator = as_float32(agent.safety_indicator(params, observation))
    attended = ~_is_last_of(state.episodes, hyper.unattended_every) & (hyper.has_arbiter > 0)
    judged = _judge(hyper, indicator, boundary_now, jnp.asarray(dangerous, bool), attended)
    arbiter_state, ruling = _rule(agent, hyper, state, judged)
    carry = _advance(agent, hyper, state, judged, ruling, attended)

    hands = actions.with_noise(agent.source, hyper.human_action_noise)
    source_state, human_action = hands.act(state.source, observation, source_key)

    decision = Decision(
        action=jnp.where(ruling.human_action, as_float32(human_action), machine_action),
        control=ruling.control,
        began=ruling.began,
        human_action=ruling.human_action,
        human_reset=ruling.human_reset,
        alarmed=judged.alarmed,
        dangerous=judged.dangerous,
        boundary=boundary_now,
        next_boundary=judged.following,
        boundary_reward=judged.reward,
        explores=_explores(hyper, state),
    )
    after = agent.human.notify(human_state, hyper.human, ruling.began, ruling.control)
    state = ActingState(
        key=key,
        steps=state.steps + 1,
        episodes=state.episodes,
        noise=noise,
        boundary=carry,
        human=caller_state.kept(_HUMAN, after, state.human),
        source=caller_state.kept(_SOURCE, source_state, state.source),
        arbiter=arbiter_state,
    )
    return state, decision


class _Judged(NamedTuple):
    """Line 7 and 8 at one step.

    Attributes:
        boundary: τ_t, [].
        indicator: c_t, [].
        alarmed: C, bool [].
        dangerous: h_t = 0, bool [].
        following: τ_{t+1} of line 8, [].
        reward: r'_t, [].
    """

    boundary: chex.Array
    indicator: chex.Array
    alarmed: chex.Array
    dangerous: chex.Array
    following: chex.Array
    reward: chex.Array


def _judge(
    hyper: RunHyper,
    indicator: chex.Array,
    boundary_now: chex.Array,
    dangerous: chex.Array,
    attended: chex.Array,
) -> _Judged:
    """The alarm, where line 8 moves the boundary, and the alarm's reward."""
    alarmed = boundary.alarm(indicator, boundary_now) & attended
    after = following(hyper, boundary_now, alarmed, dangerous)
    reward = boundary.boundary_reward(alarmed, dangerous, hyper.alarm_reward, hyper.human_price)
    return _Judged(boundary_now, indicator, alarmed, dangerous, after, reward)


def _rule(
    agent: Agent, hyper: RunHyper, state: ActingState, judged: _Judged
) -> tuple[chex.ArrayTree, Ruling]:
    """The intervention's next state, and what it rules."""
    objects = jnp.logical_and(judged.dangerous, hyper.human_present > 0)
    keeps = agent.release(
        Takeover(
            dangerous=objects,
            indicator=judged.indicator,
            boundary=judged.boundary,
            release_share=hyper.release_share,
            extra=hyper.extra,
        )
    )
    situation = Situation(
        alarmed=judged.alarmed,
        dangerous=objects,
        keeps=jnp.asarray(keeps, bool),
        takeover_steps=hyper.takeover_steps,
        extra=hyper.extra,
    )
    after, ruling = agent.intervention.rule(state.arbiter, situation)
    return caller_state.kept(_INTERVENTION, after, state.arbiter), ruling


def _advance(
    agent: Agent,
    hyper: RunHyper,
    state: ActingState,
    judged: _Judged,
    ruling: Ruling,
    attended: chex.Array,
) -> chex.Array:
    """The boundary source's next carry; it stays where the boundary is fixed or nobody looks."""
    move = boundary.Move(
        boundary=judged.boundary,
        following=judged.following,
        alarmed=judged.alarmed,
        control=ruling.control,
        step=hyper.delta_plus,
        target_rate=hyper.target_rate,
        low=hyper.boundary_low,
        high=hyper.boundary_high,
        extra=hyper.extra,
    )
    learns = (hyper.learns_boundary > 0) & attended
    after = next_carry(agent.boundary_source, state.boundary, move)
    return jnp.where(learns, after, state.boundary)


def following(
    hyper: RunHyper, boundary_now: chex.Array, alarmed: chex.Array, dangerous: chex.Array
) -> chex.Array:
    """τ_{t+1} of line 8 within the run's bounds, []; τ_t where the boundary is fixed.

    Args:
        hyper: the run's hyperparameters, scalars.
        boundary_now: τ_t, [].
        alarmed: C, bool [].
        dangerous: h_t = 0, bool [].
    """
    after = boundary.next_boundary(
        boundary_now, alarmed, dangerous, hyper.delta_minus, hyper.delta_plus
    )
    after = jnp.clip(after, hyper.boundary_low, hyper.boundary_high)
    return jnp.where(hyper.learns_boundary > 0, after, boundary_now)


def _or_random(
    hyper: RunHyper, state: ActingState, action: chex.Array, key: chex.PRNGKey
) -> chex.Array:
    """The action, or a uniformly random one where the run is in its warm-up, [A]."""
    random_action = jax.random.uniform(key, action.shape, jnp.float32, -1.0, 1.0)
    return jnp.where(acts_at_random(hyper, state.steps), random_action, action)


def _explore(
    agent: Agent,
    hyper: RunHyper,
    actor: Params,
    state: ActingState,
    observation: chex.Array,
    key: chex.PRNGKey,
) -> tuple[chex.Array, chex.Array]:
    """The next noise, and the learner's action with it, [A] each."""
    rho = hyper.noise_correlation
    fresh = jax.random.normal(key, state.noise.shape, jnp.float32)
    noise = rho * state.noise + jnp.sqrt(1.0 - rho**2) * fresh
    scale = jnp.where(_noise_free(hyper, state), 0.0, _noise_scale(hyper, state.steps))
    action = agent.learner.act(hyper, actor, observation, noise, scale)
    return noise, jnp.clip(action, -1.0, 1.0)


def _noise_free(hyper: RunHyper, state: ActingState) -> chex.Array:
    """Whether the episode under way has no action noise."""
    return _is_last_of(state.episodes, hyper.noise_free_every)


def _noise_scale(hyper: RunHyper, steps: chex.Array) -> chex.Array:
    """The standard deviation of the action noise after so many steps of the run, []."""
    faded = jnp.minimum(steps / jnp.maximum(hyper.noise_steps, 1), 1.0)
    scale = (1.0 - faded) * hyper.exploration_noise + faded * hyper.final_noise
    return jnp.where(hyper.noise_steps > 0, scale, hyper.exploration_noise)


def _explores(hyper: RunHyper, state: ActingState) -> chex.Array:
    """Whether the machine's action is not as in a test, where some episodes' are."""
    noisy = ~_noise_free(hyper, state) & (_noise_scale(hyper, state.steps) > 0)
    return (hyper.noise_free_every > 0) & (noisy | acts_at_random(hyper, state.steps))


def _is_last_of(episodes: chex.Array, every: chex.Array) -> chex.Array:
    """Whether the episode under way, the `episodes`-th, is the last of `every`; never of 0."""
    return (every > 0) & (episodes % jnp.maximum(every, 1) == 0)


def _boundary(
    agent: Agent,
    hyper: RunHyper,
    actor: Params,
    state: ActingState,
    observation: chex.Array,
    key: chex.PRNGKey,
) -> chex.Array:
    """τ_t (line 6): from the boundary source where it is learned, τ_0 where it is fixed."""
    learner = agent.boundary_learner
    noise = hyper.boundary_noise * learner.noise(key)
    network = learner.boundary(hyper, actor, observation) + noise
    learned = agent.boundary_source.boundary(state.boundary, network)
    learned = jnp.clip(learned, hyper.boundary_low, hyper.boundary_high)
    return jnp.where(hyper.learns_boundary > 0, learned, hyper.initial_boundary)
