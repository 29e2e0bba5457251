"""One run of the human-machine team: init, act and update, to be vmapped by the caller."""

import dataclasses
import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax
from flax import struct

from hitl_jax import arbiter, boundary, human, human_actions, losses, networks, replay
from hitl_jax.config import AgentConfig, RunHyper
from hitl_jax.indicator import Indicator, get_indicator
from hitl_jax.types import (
    Behavior,
    BoundaryState,
    BoundaryTransition,
    LearnerState,
    Params,
    TrainState,
    Transition,
)

_adam = optax.scale_by_adam()


@struct.dataclass
class ActingState:
    """What acting remembers in one run.

    Attributes:
        key: typed PRNG key of the run's acting, [].
        steps: environment steps taken, int32 [].
        noise: the action noise in units of its standard deviation, [A].
        boundary: the boundary source's carry, [].
        human: the human's state.
        source: the state of the human's actions.
        arbiter: the arbiter's state.
    """

    key: chex.PRNGKey
    steps: chex.Array
    noise: chex.Array
    boundary: chex.Array
    human: chex.ArrayTree
    source: chex.ArrayTree
    arbiter: arbiter.ArbiterState


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
        next_boundary: τ_{t+1}, [].
        boundary_reward: r'_t, [].
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


class Agent(NamedTuple):
    """The parts of the team, each a choice of one interface.

    Attributes:
        config: static choices.
        indicator: c_t of an observation.
        human: the judgement h_t.
        source: the human's actions a^h.
    """

    config: AgentConfig
    indicator: Indicator
    human: human.HumanPart
    source: human_actions.ActionSource

    @property
    def actor(self) -> networks.Actor:
        """μ."""
        return networks.Actor(self.config.hidden_sizes, self.config.action_size)

    @property
    def critic(self) -> networks.Critics:
        """Q."""
        return networks.Critics(self.config.hidden_sizes, self.config.num_critics)

    @property
    def first_critic(self) -> networks.Critics:
        """Q_1, the critic that the actor follows."""
        return networks.Critics(self.config.hidden_sizes, 1)

    @property
    def boundary_actor(self) -> networks.BoundaryActor:
        """π_θ."""
        return networks.BoundaryActor(self.config.boundary_hidden_sizes)

    @property
    def boundary_critic(self) -> networks.BoundaryCritic:
        """Q_ω."""
        return networks.BoundaryCritic(self.config.boundary_hidden_sizes)

    @property
    def layout(self) -> replay.Layout:
        """Columns of a frame in replay."""
        return replay.Layout(self.config.observation_size, self.config.action_size)


def make_agent(
    config: AgentConfig,
    indicator: Indicator | None = None,
    judge: human.HumanPart | None = None,
    source: human_actions.ActionSource | None = None,
) -> Agent:
    """Puts a team together; what is not given is made from `config`.

    Args:
        config: static choices.
        indicator: a safety indicator of one's own, observation [O] to c_t [].
        judge: a human of one's own.
        source: human actions of one's own; the scripted walker by default.
    """
    return Agent(
        config=config,
        indicator=indicator or get_indicator(config.indicator),
        human=judge or human.simulated_human(config.danger),
        source=source or human_actions.scripted_walker(),
    )


def init(agent: Agent, key: chex.PRNGKey) -> TrainState:
    """Random networks and fresh optimisers of one run (line 2).

    Args:
        agent: the team.
        key: consumed, [].
    """
    keys = jax.random.split(key, 5)
    observation = jnp.zeros((1, agent.config.observation_size))
    action = jnp.zeros((1, agent.config.action_size))
    scalar = jnp.zeros((1,))
    actor = agent.actor.init(keys[0], observation)
    critic = agent.critic.init(keys[1], observation, action)
    boundary_actor = agent.boundary_actor.init(keys[2], observation, scalar, scalar, scalar)
    boundary_critic = agent.boundary_critic.init(keys[3], observation, scalar)
    return TrainState(
        learner=LearnerState(
            actor=actor,
            critic=critic,
            target_actor=actor,
            target_critic=critic,
            actor_optimizer=_adam.init(actor),
            critic_optimizer=_adam.init(critic),
        ),
        boundary=BoundaryState(
            actor=boundary_actor,
            critic=boundary_critic,
            actor_optimizer=_adam.init(boundary_actor),
            critic_optimizer=_adam.init(boundary_critic),
        ),
        key=keys[4],
    )


def behavior(state: TrainState) -> Behavior:
    """The part of a run's state that acting needs."""
    return Behavior(actor=state.learner.actor, boundary_actor=state.boundary.actor)


def init_acting(agent: Agent, hyper: RunHyper, key: chex.PRNGKey) -> ActingState:
    """Acting at the first step of a run.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        key: consumed, [].
    """
    source = boundary.get_source(agent.config.boundary_source)
    initial = jnp.asarray(hyper.initial_boundary, jnp.float32)
    return ActingState(
        key=key,
        steps=jnp.zeros((), jnp.int32),
        noise=jnp.zeros((agent.config.action_size,)),
        boundary=source.init(initial),
        human=agent.human.init(),
        source=agent.source.init(),
        arbiter=arbiter.init(),
    )


def begin_episode(agent: Agent, state: ActingState) -> ActingState:
    """Forgets what belongs to an episode; boundary, step count and attention go on."""
    return dataclasses.replace(
        state,
        noise=jnp.zeros_like(state.noise),
        human=agent.human.begin_episode(state.human),
        source=agent.source.begin_episode(state.source),
        arbiter=arbiter.init(),
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
    key, noise_key, warmup_key, boundary_key, human_key, source_key = jax.random.split(state.key, 6)

    noise, machine_action = _explore(agent, hyper, params.actor, state, observation, noise_key)
    random_action = jax.random.uniform(warmup_key, machine_action.shape, minval=-1.0, maxval=1.0)
    machine_action = jnp.where(state.steps < hyper.warmup_steps, random_action, machine_action)

    boundary_now = _boundary(agent, hyper, params.boundary_actor, state, observation, boundary_key)
    human_state, dangerous = agent.human.judge(
        state.human, hyper.human, observation, jnp.zeros((), bool), human_key
    )
    alarmed = boundary.alarm(agent.indicator(observation), boundary_now)
    alarmed = jnp.logical_and(alarmed, hyper.has_arbiter > 0)
    after = boundary.next_boundary(
        boundary_now, alarmed, dangerous, hyper.delta_minus, hyper.delta_plus
    )
    after = jnp.clip(after, hyper.boundary_low, hyper.boundary_high)
    learns = hyper.learns_boundary > 0
    after = jnp.where(learns, after, boundary_now)
    source = boundary.get_source(agent.config.boundary_source)
    carry = jnp.where(learns, source.advance(state.boundary, boundary_now, after), state.boundary)

    objects = jnp.logical_and(dangerous, hyper.human_present > 0)
    arbiter_state, ruling = arbiter.rule(
        state.arbiter, agent.config.intervention, alarmed, objects, hyper.takeover_steps
    )
    hands = human_actions.with_noise(agent.source, hyper.human_action_noise)
    source_state, human_action = hands.act(state.source, observation, source_key)

    decision = Decision(
        action=jnp.where(ruling.human_action, human_action, machine_action),
        control=ruling.control,
        began=ruling.began,
        human_action=ruling.human_action,
        human_reset=ruling.human_reset,
        alarmed=alarmed,
        dangerous=dangerous,
        boundary=boundary_now,
        next_boundary=after,
        boundary_reward=boundary.boundary_reward(alarmed, dangerous, hyper.alarm_reward),
    )
    state = ActingState(
        key=key,
        steps=state.steps + 1,
        noise=noise,
        boundary=carry,
        human=agent.human.notify(human_state, hyper.human, ruling.began, ruling.control),
        source=source_state,
        arbiter=arbiter_state,
    )
    return state, decision


def update(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    batch: Transition,
    key: chex.PRNGKey,
    update_actor: bool = True,
) -> tuple[TrainState, losses.Metrics]:
    """One update of the task learner: critics, and with `update_actor` actor and targets.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        state: the run's training state.
        batch: minibatch, leading axis B.
        key: consumed by the target smoothing.
        update_actor: static; DDPG gives True at every update, TD3 at every second.

    Returns:
        The next state and metrics, each [].
    """
    learner = state.learner
    next_action = agent.actor.apply(learner.target_actor, batch.next_observation)
    if agent.config.smooths_target:
        noise = jax.random.normal(key, batch.action.shape)
        next_action = losses.smoothed_action(
            next_action, noise, hyper.target_noise, hyper.target_noise_clip
        )
    next_q = agent.critic.apply(learner.target_critic, batch.next_observation, next_action)
    target = losses.target_q(batch.reward, batch.discount, next_q)
    grads, metrics = jax.grad(losses.critic_loss, has_aux=True)(
        learner.critic, agent.critic.apply, batch, target
    )
    critic, critic_optimizer = _descend(
        learner.critic, grads, learner.critic_optimizer, hyper.critic_learning_rate
    )
    learner = dataclasses.replace(learner, critic=critic, critic_optimizer=critic_optimizer)
    if update_actor:
        grads, actor_metrics = jax.grad(losses.actor_loss, has_aux=True)(
            learner.actor, agent.actor.apply, agent.first_critic.apply, critic, batch.observation
        )
        actor, actor_optimizer = _descend(
            learner.actor, grads, learner.actor_optimizer, hyper.actor_learning_rate
        )
        step = hyper.target_step_size
        learner = dataclasses.replace(
            learner,
            actor=actor,
            actor_optimizer=actor_optimizer,
            target_actor=optax.incremental_update(actor, learner.target_actor, step),
            target_critic=optax.incremental_update(critic, learner.target_critic, step),
        )
        metrics = metrics | actor_metrics
    return dataclasses.replace(state, learner=learner), metrics


def update_boundary(
    agent: Agent, hyper: RunHyper, state: TrainState, batch: BoundaryTransition
) -> tuple[TrainState, losses.Metrics]:
    """One update of the boundary learner (lines 10 to 12).

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        state: the run's training state.
        batch: minibatch of the pool D, leading axis N.

    Returns:
        The next state and metrics, each [].
    """
    current = state.boundary
    grads, metrics = jax.grad(boundary.boundary_critic_loss, has_aux=True)(
        current.critic, agent.boundary_critic.apply, batch
    )
    critic, critic_optimizer = _descend(
        current.critic, grads, current.critic_optimizer, hyper.boundary_critic_learning_rate
    )
    grads, actor_metrics = jax.grad(boundary.boundary_actor_loss, has_aux=True)(
        current.actor,
        functools.partial(_network_boundary, agent, hyper),
        agent.boundary_critic.apply,
        critic,
        batch.observation,
    )
    actor, actor_optimizer = _descend(
        current.actor, grads, current.actor_optimizer, hyper.boundary_actor_learning_rate
    )
    after = BoundaryState(
        actor=actor,
        critic=critic,
        actor_optimizer=actor_optimizer,
        critic_optimizer=critic_optimizer,
    )
    return dataclasses.replace(state, boundary=after), metrics | actor_metrics


def learn(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    memory: replay.Replay,
    column: chex.Array,
    num_updates: int,
) -> TrainState:
    """`num_updates` updates of one run from its column of the replay, and one of its boundary.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        state: the run's training state.
        memory: the replay.
        column: the run's column, int32 [].
        num_updates: static; a multiple of the policy delay, so that the delay never drifts.

    Returns:
        The next training state.

    Raises:
        ValueError: at trace time, if `num_updates` is no multiple of the policy delay.
    """
    config = agent.config
    if num_updates % config.policy_delay:
        raise ValueError(
            f"{num_updates} updates are no multiple of the policy delay {config.policy_delay}"
        )

    def several(_: int, state: TrainState) -> TrainState:
        for index in range(config.policy_delay):
            key, sample_key, smoothing_key = jax.random.split(state.key, 3)
            state = dataclasses.replace(state, key=key)
            batch = replay.sample(
                memory,
                agent.layout,
                column,
                sample_key,
                config.batch_size,
                config.n_step,
                hyper.gamma,
            )
            last = index == config.policy_delay - 1
            state, _metrics = update(agent, hyper, state, batch, smoothing_key, update_actor=last)
        return state

    state = jax.lax.fori_loop(0, num_updates // config.policy_delay, several, state)
    key, boundary_key = jax.random.split(state.key)
    pool = replay.sample_boundary(
        memory, agent.layout, column, boundary_key, config.boundary_batch_size, hyper.gamma
    )
    state, _metrics = update_boundary(agent, hyper, dataclasses.replace(state, key=key), pool)
    return state


def _explore(
    agent: Agent,
    hyper: RunHyper,
    actor: Params,
    state: ActingState,
    observation: chex.Array,
    key: chex.PRNGKey,
) -> tuple[chex.Array, chex.Array]:
    """The next noise [A] and μ(s_t) plus that noise, [A]."""
    rho = hyper.noise_correlation
    fresh = jax.random.normal(key, state.noise.shape)
    noise = rho * state.noise + jnp.sqrt(1.0 - rho**2) * fresh
    action = agent.actor.apply(actor, observation) + hyper.exploration_noise * noise
    return noise, jnp.clip(action, -1.0, 1.0)


def _network_boundary(
    agent: Agent, hyper: RunHyper, params: Params, observation: chex.Array
) -> chex.Array:
    return agent.boundary_actor.apply(
        params, observation, hyper.initial_boundary, hyper.boundary_low, hyper.boundary_high
    )


def _boundary(
    agent: Agent,
    hyper: RunHyper,
    actor: Params,
    state: ActingState,
    observation: chex.Array,
    key: chex.PRNGKey,
) -> chex.Array:
    """τ_t (line 6): from the boundary source where it is learned, τ_0 where it is fixed."""
    source = boundary.get_source(agent.config.boundary_source)
    noise = hyper.boundary_noise * jax.random.normal(key, ())
    network = _network_boundary(agent, hyper, actor, observation) + noise
    learned = source.boundary(state.boundary, network)
    learned = jnp.clip(learned, hyper.boundary_low, hyper.boundary_high)
    return jnp.where(hyper.learns_boundary > 0, learned, hyper.initial_boundary)


def _descend(
    params: Params, grads: Params, optimizer: optax.OptState, learning_rate: chex.Array
) -> tuple[Params, optax.OptState]:
    """One Adam step with a traced learning rate."""
    direction, optimizer = _adam.update(grads, optimizer)
    step = jax.tree.map(lambda leaf: -learning_rate * leaf, direction)
    return optax.apply_updates(params, step), optimizer
