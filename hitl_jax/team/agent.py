"""One run of the human-machine team: its parts, init and update, to be vmapped by the caller."""

import dataclasses
import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax import boundary, human
from hitl_jax.config import AgentConfig, RunHyper, as_float32, traced
from hitl_jax.human import actions
from hitl_jax.human.indicator import Indicator, get_indicator
from hitl_jax.learner import losses, networks, replay
from hitl_jax.learner.frame import Layout
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
_MEAN_DECAY, _SQUARE_DECAY, _EPSILON = 0.9, 0.999, 1e-8


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
    source: actions.ActionSource

    @property
    def actor(self) -> networks.Actor:
        """μ."""
        config = self.config
        return networks.Actor(
            config.hidden_sizes, config.action_size, matmul_precision=config.matmul_precision
        )

    @property
    def critic(self) -> networks.Critics:
        """Q."""
        return self._critics(self.config.task_learner.num_critics)

    @property
    def first_critic(self) -> networks.Critics:
        """Q_1, the critic that the actor follows."""
        return self._critics(1)

    def _critics(self, num_critics: int) -> networks.Critics:
        config = self.config
        return networks.Critics(
            config.hidden_sizes,
            num_critics,
            config.layer_norm,
            config.task_learner.num_quantiles,
            matmul_precision=config.matmul_precision,
        )

    @property
    def boundary_actor(self) -> networks.BoundaryActor:
        """π_θ."""
        return networks.BoundaryActor(self.config.boundary_hidden_sizes)

    @property
    def boundary_critic(self) -> networks.BoundaryCritic:
        """Q_ω."""
        return networks.BoundaryCritic(self.config.boundary_hidden_sizes)

    def network_boundary(
        self, hyper: RunHyper, params: Params, observation: chex.Array
    ) -> chex.Array:
        """π_θ(s) within the run's bounds, [...], for observations [..., O]."""
        return self.boundary_actor.apply(
            params, observation, hyper.initial_boundary, hyper.boundary_low, hyper.boundary_high
        )

    @property
    def layout(self) -> Layout:
        """Columns of a frame in replay."""
        return Layout(self.config.observation_size, self.config.action_size)


def make_agent(
    config: AgentConfig,
    indicator: Indicator | None = None,
    judge: human.HumanPart | None = None,
    source: actions.ActionSource | None = None,
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
        source=source or actions.scripted_walker(),
    )


def init(agent: Agent, key: chex.PRNGKey) -> TrainState:
    """Random networks and fresh optimisers of one run (line 2).

    Args:
        agent: the team.
        key: consumed, [].
    """
    keys = jax.random.split(key, 5)
    observation = jnp.zeros((1, agent.config.observation_size), jnp.float32)
    action = jnp.zeros((1, agent.config.action_size), jnp.float32)
    scalar = jnp.zeros((1,), jnp.float32)
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


def update(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    batch: Transition,
    noise: chex.Array,
    update_actor: bool = True,
) -> tuple[TrainState, losses.Metrics]:
    """One update of the task learner: critics, and with `update_actor` actor and targets.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        state: the run's training state.
        batch: minibatch, leading axis B.
        noise: standard normal ε of the target smoothing, [B, A]; DDPG does not look at it.
        update_actor: static; True at one update in `policy_delay`.

    Returns:
        The next state and metrics, each [].
    """
    hyper, (batch, noise) = traced(hyper), as_float32((batch, noise))
    target = _target(agent, hyper, state.learner, batch, noise)
    return _improve(agent, hyper, state, batch, target, update_actor)


def _target(
    agent: Agent, hyper: RunHyper, learner: LearnerState, batch: Transition, noise: chex.Array
) -> chex.ArrayTree:
    """TD targets of a minibatch: what the learner's `target` gives, leaves [..., B]."""
    rules = agent.config.task_learner
    next_action = agent.actor.apply(learner.target_actor, batch.next_observation)
    if rules.smooths_target:
        next_action = losses.smoothed_action(
            next_action, noise, hyper.target_noise, hyper.target_noise_clip
        )
    next_q = agent.critic.apply(learner.target_critic, batch.next_observation, next_action)
    return rules.target(batch.reward, batch.discount, next_q)


def _improve(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    batch: Transition,
    target: chex.ArrayTree,
    update_actor: bool,
) -> tuple[TrainState, losses.Metrics]:
    """`update` with the TD targets given."""
    learner, rules = state.learner, agent.config.task_learner
    grads, metrics = jax.grad(rules.critic_loss, has_aux=True)(
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
    hyper, batch = traced(hyper), as_float32(batch)
    current = state.boundary
    grads, metrics = jax.grad(boundary.boundary_critic_loss, has_aux=True)(
        current.critic, agent.boundary_critic.apply, batch
    )
    critic, critic_optimizer = _descend(
        current.critic, grads, current.critic_optimizer, hyper.boundary_critic_learning_rate
    )
    grads, actor_metrics = jax.grad(boundary.boundary_actor_loss, has_aux=True)(
        current.actor,
        functools.partial(agent.network_boundary, hyper),
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
    """`num_updates` updates of one run, and one of its boundary where that is learned (HITL-AC).

    Minibatches are drawn from its column of the replay.

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
    hyper, config = traced(hyper), agent.config
    delay = config.task_learner.policy_delay
    if num_updates % delay:
        raise ValueError(f"{num_updates} updates are no multiple of the policy delay {delay}")

    key, sample_key, noise_key, boundary_key = jax.random.split(state.key, 4)
    # Everything random is drawn at once: a generator is many small kernels, whatever it draws. Rows
    # are read in the loop: read at once, XLA would find their places anew for every number.
    groups, rows = num_updates // delay, delay * config.batch_size
    drawn = replay.draw(
        memory, agent.layout, column, sample_key, groups * rows, config.n_step, hyper.gamma
    )
    drawn = jax.tree.map(lambda leaf: leaf.reshape(groups, rows), drawn)
    # Long rows: XLA works along the last axis.
    noise = jax.random.normal(noise_key, (groups, rows * config.action_size), jnp.float32)

    def several(
        state: TrainState, given: tuple[replay.Draw, chex.Array]
    ) -> tuple[TrainState, None]:
        draw, smoothing = given
        batch = replay.read(memory, agent.layout, column, draw)
        # Target networks move only when the actor does: the updates until then share their targets.
        targets = _target(agent, hyper, state.learner, batch, smoothing.reshape(rows, -1))
        for index in range(delay):
            part = slice(index * config.batch_size, (index + 1) * config.batch_size)
            one = jax.tree.map(lambda leaf, part=part: leaf[part], batch)
            target = jax.tree.map(lambda leaf, part=part: leaf[..., part], targets)
            state, _metrics = _improve(agent, hyper, state, one, target, index == delay - 1)
        return state, None

    state, _ = jax.lax.scan(several, dataclasses.replace(state, key=key), (drawn, noise))

    def learn_boundary(state: TrainState) -> BoundaryState:
        pool = replay.sample_boundary(
            memory, agent.layout, column, boundary_key, config.boundary_batch_size, hyper.gamma
        )
        return update_boundary(agent, hyper, state, pool)[0].boundary

    # Where runs are taken one by one, the methods that learn no boundary do not pay for it.
    learned = jax.lax.cond(
        hyper.learns_boundary > 0, learn_boundary, lambda state: state.boundary, state
    )
    return dataclasses.replace(state, boundary=learned)


def _descend(
    params: Params, grads: Params, optimizer: optax.OptState, learning_rate: chex.Array
) -> tuple[Params, optax.OptState]:
    """One Adam step with a traced learning rate (https://arxiv.org/abs/1412.6980).

    Optax's, but for powers of the decays: it takes those in the widest type that JAX may use.
    """
    count = optax.safe_increment(optimizer.count)

    def moment(decay: float, before: Params, seen: Params) -> Params:
        return jax.tree.map(lambda old, new: (1.0 - decay) * new + decay * old, before, seen)

    def corrected(decay: float, moments: Params) -> Params:
        scale = 1.0 - jnp.float32(decay) ** count
        return jax.tree.map(lambda leaf: leaf / scale, moments)

    mean = moment(_MEAN_DECAY, optimizer.mu, grads)
    square = moment(_SQUARE_DECAY, optimizer.nu, jax.tree.map(jnp.square, grads))
    direction = jax.tree.map(
        lambda m, v: m / (jnp.sqrt(v) + _EPSILON),
        corrected(_MEAN_DECAY, mean),
        corrected(_SQUARE_DECAY, square),
    )
    step = jax.tree.map(lambda leaf: -learning_rate * leaf, direction)
    return optax.apply_updates(params, step), optimizer._replace(count=count, mu=mean, nu=square)
