"""A team put together, its initial state and its updates. The caller vmaps them."""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp

from hitl_jax import human
from hitl_jax.arbiter import INTERVENTIONS, RELEASES, Intervention
from hitl_jax.arbiter.releases import Release
from hitl_jax.boundary import BOUNDARY_LEARNERS, SOURCES, BoundaryLearner, BoundarySource
from hitl_jax.choices.options import all_options, require_known
from hitl_jax.config import AgentConfig, Hyper, RunHyper, as_float32, traced, validate_hyper
from hitl_jax.errors import InvalidValue, blamed_on, name_of
from hitl_jax.human import actions
from hitl_jax.human.actions import ACTION_SOURCES
from hitl_jax.human.indicator import INDICATORS, Indicator
from hitl_jax.learner import losses, replay
from hitl_jax.learner.algorithms import LEARNERS
from hitl_jax.learner.task_learner import TaskLearner
from hitl_jax.team.parts import Agent, after_updates, first_average
from hitl_jax.team.parts import behavior as behavior
from hitl_jax.team.trial_run import require_runs
from hitl_jax.types import (
    BoundaryState,
    BoundaryTransition,
    RiskState,
    TrainState,
    Transition,
)

_OF_RISK = 1
"""What keys are folded with for the risk critic, so that the other learners' stay as they are."""


def make_agent(
    config: AgentConfig,
    indicator: Indicator | None = None,
    judge: human.HumanPart | None = None,
    source: actions.ActionSource | None = None,
    *,
    learner: TaskLearner | None = None,
    boundary_source: BoundarySource | None = None,
    boundary_learner: BoundaryLearner | None = None,
    intervention: Intervention | None = None,
    release: Release | None = None,
) -> Agent:
    """Puts a team together; what is not given is made from `config`.

    Args:
        config: static choices.
        indicator: a safety indicator of one's own, observation [O] to c_t [].
        judge: a human of one's own.
        source: human actions of one's own.
        learner: a task learner of one's own.
        boundary_source: a boundary source of one's own.
        boundary_learner: a boundary learner of one's own.
        intervention: an intervention of one's own.
        release: an end of takeovers of one's own.

    Raises:
        InvalidValue: one line, for a choice that is none, one that was made for observations of
            another size, or one that does not do what its protocol says (`team.trial_run`).
    """
    given = {
        "indicator": indicator,
        "judge": judge,
        "human_actions": source,
        "learner": learner,
        "boundary_source": boundary_source,
        "boundary_learner": boundary_learner,
        "intervention": intervention,
        "release": release,
    }
    chosen = {
        name: getattr(config, name, None) if value is None else value
        for name, value in given.items()
    }
    agent = Agent(
        config=config,
        indicator=INDICATORS.make(chosen["indicator"]),
        human=_human(config) if judge is None else _own_human(judge),
        source=ACTION_SOURCES.make(chosen["human_actions"], config.action_size),
        learner=LEARNERS.make(chosen["learner"], config),
        boundary_source=SOURCES.make(chosen["boundary_source"]),
        boundary_learner=BOUNDARY_LEARNERS.make(chosen["boundary_learner"], config),
        intervention=INTERVENTIONS.make(chosen["intervention"]),
        release=RELEASES.make(chosen["release"]),
    )
    named = {
        name: one if isinstance(one, str) else name_of(one)
        for name, one in chosen.items()
        if one is not None
    }
    _require_sizes(agent, {"danger": config.danger} | named)
    _require_looked_at(agent)
    require_runs(agent, named)
    return agent


def _human(config: AgentConfig) -> human.HumanPart:
    """The simulated human of a configuration."""
    with blamed_on("human_parts", " ".join(config.human_parts)):
        return human.simulated_human(config.danger, parts=config.human_parts)


def _own_human(judge: Any) -> human.HumanPart:
    """A human of a caller's own, checked."""
    if not isinstance(judge, human.HumanPart):
        why = "must be a HumanPart, as `human.simulated_human()` gives one"
        raise InvalidValue("judge", name_of(judge), why)
    human.HUMAN_PARTS.require(judge, name_of(judge), "judge")
    return judge


def _require_sizes(agent: Agent, named: dict[str, str]) -> None:
    """Refuses parts that were made for other observations or actions than the team's."""
    config, judge = agent.config, "judge" if "judge" in named else "danger"
    for name, part in (
        ("indicator", agent.indicator),
        (judge, agent.human),
        ("human_actions", agent.source),
    ):
        for what in ("observation", "action"):
            made_for, size = (getattr(of, f"{what}_size", None) for of in (part, config))
            if made_for not in (None, size):
                why = f"is made for {what}s of {made_for} numbers, and the walkers' have {size}: "
                why += "choose another, or give one of your own"
                raise InvalidValue(name, named[name], why)


def _require_looked_at(agent: Agent) -> None:
    """Refuses a use of human steps beside a learner that makes something else of them."""
    chosen, has = agent.human_data, getattr(agent.learner, "human_data", None)
    if has is None and (chosen.changes_actor or chosen.changes_critic):
        why = "this task learner does not look at it: must be `transitions` or `half`"
        raise InvalidValue("human_data", agent.config.human_data, why)
    if has is not None and has != chosen:
        why = f"the task learner was made with another, {has}"
        raise InvalidValue("human_data", agent.config.human_data, why)


def validate(agent: Agent, hyper: Hyper) -> None:
    """Checks host values before any work starts, those of the choices' own options included.

    Args:
        agent: the team.
        hyper: scalars, not yet on a device.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    validate_hyper(hyper)
    require_extra(agent, hyper)
    if agent.human_data.replaces_reward and hyper.reward_weight != 0.0:
        why = f"must be 0 beside human_data {agent.config.human_data}, which stands in its place"
        raise InvalidValue("reward_weight", hyper.reward_weight, why, mentions=("human_data",))


def require_extra(agent: Agent, hyper: Hyper) -> None:
    """Checks the numbers of the choices' own options; see `validate`."""
    require_known(hyper.extra, agent.options)
    require_known(hyper.human.extra, all_options([agent.human]), "human.extra")


def init(agent: Agent, key: chex.PRNGKey) -> TrainState:
    """Random networks and fresh optimisers of one run (line 2).

    Args:
        agent: the team.
        key: consumed, [].
    """
    keys = jax.random.split(key, 5)
    risk, learner = agent.risk_learner, agent.learner.init(keys[0], keys[1])
    return TrainState(
        learner=learner,
        boundary=agent.boundary_learner.init(keys[2], keys[3]),
        key=keys[4],
        risk=None if risk is None else risk.init(jax.random.fold_in(keys[2], _OF_RISK)),
        average=first_average(agent.config, learner.actor),
    )


def update(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    batch: Transition,
    noise: chex.Array,
    last: bool = True,
) -> tuple[TrainState, losses.Metrics]:
    """One update of the task learner.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        state: the run's training state.
        batch: minibatch, leading axis B.
        noise: standard normal, [B, `agent.learner.noise_size`].
        last: static; True at one update in `policy_delay`, which improves the actor as well.

    Returns:
        The next state and metrics, each [].
    """
    hyper, (batch, noise) = traced(agent.with_extra(hyper)), as_float32((batch, noise))
    target = agent.learner.targets(hyper, state.learner, batch, noise)
    learner, metrics = agent.learner.improve(hyper, state.learner, batch, target, noise, last)
    if not last:
        return dataclasses.replace(state, learner=learner), metrics
    return after_updates(state, learner, hyper.average_step_size), metrics


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
    hyper, batch = traced(agent.with_extra(hyper)), as_float32(batch)
    learned, metrics = agent.boundary_learner.improve(hyper, state.boundary, batch)
    return dataclasses.replace(state, boundary=learned), metrics


def learn(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    memory: replay.Replay,
    column: chex.Array,
    num_updates: int,
) -> TrainState:
    """`num_updates` updates of one run, and some of its other learners.

    The boundary is learned in HITL-AC; the risk where the team looks at it and there is an arbiter.
    Minibatches are drawn from the run's column of the replay.

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
    hyper, delay = traced(agent.with_extra(hyper)), agent.learner.policy_delay
    if num_updates % delay:
        raise ValueError(f"{num_updates} updates are no multiple of the policy delay {delay}")
    key, sample_key, noise_key, boundary_key = jax.random.split(state.key, 4)
    state = dataclasses.replace(state, key=key)
    keys = sample_key, noise_key
    state = _learn_task(agent, hyper, state, memory, column, num_updates // delay, keys)

    def learn_boundary(state: TrainState) -> BoundaryState:
        learner = agent.boundary_learner

        def once(state: TrainState, key: chex.PRNGKey) -> tuple[TrainState, None]:
            pool = agent.draw_boundary(hyper, state, memory, column, key)
            return update_boundary(agent, hyper, state, pool)[0], None

        if learner.num_updates == 1:
            return once(state, boundary_key)[0].boundary
        keys = jax.random.split(boundary_key, learner.num_updates)
        return jax.lax.scan(once, state, keys)[0].boundary

    # Where runs are taken one by one, the methods that learn no boundary do not pay for it.
    learned = jax.lax.cond(
        hyper.learns_boundary > 0, learn_boundary, lambda state: state.boundary, state
    )
    state = dataclasses.replace(state, boundary=learned)
    risk, before = agent.risk_learner, state.risk
    if risk is None or before is None:
        return state

    def learn_risk(before: RiskState) -> RiskState:
        risk_key = jax.random.fold_in(boundary_key, _OF_RISK)
        return risk.improve(hyper, before, *risk.draw(memory, agent.layout, column, risk_key))[0]

    after = jax.lax.cond(hyper.has_arbiter > 0, learn_risk, lambda before: before, before)
    return dataclasses.replace(state, risk=after)


def _learn_task(
    agent: Agent,
    hyper: RunHyper,
    state: TrainState,
    memory: replay.Replay,
    column: chex.Array,
    groups: int,
    keys: tuple[chex.PRNGKey, chex.PRNGKey],
) -> TrainState:
    """`groups` times `policy_delay` updates of the task learner; both keys are consumed."""
    config, learner = agent.config, agent.learner
    rows = learner.policy_delay * config.batch_size
    sample_key, noise_key = keys
    # Everything random is drawn at once: a generator is many small kernels, whatever it draws. Rows
    # are read in the loop: read at once, XLA would find their places anew for every number.
    drawn = replay.draw(
        memory,
        agent.layout,
        column,
        sample_key,
        groups * rows,
        config.n_step,
        hyper.gamma,
        human_share=agent.human_data.share,
        num_batches=groups * learner.policy_delay,
    )
    drawn = jax.tree.map(lambda leaf: leaf.reshape(groups, rows), drawn)
    # Long rows: XLA works along the last axis.
    noise = jax.random.normal(noise_key, (groups, rows * learner.noise_size), jnp.float32)

    def group(state: TrainState, given: tuple[replay.Draw, chex.Array]) -> tuple[TrainState, None]:
        draw, normal = given
        batch = replay.read(memory, agent.layout, column, draw)
        normal, after = normal.reshape(rows, learner.noise_size), state.learner
        # Targets move only at the last of these updates, which therefore share them.
        targets = learner.targets(hyper, after, batch, normal)
        for index in range(learner.policy_delay):
            part = slice(index * config.batch_size, (index + 1) * config.batch_size)
            one = jax.tree.map(lambda leaf, part=part: leaf[part], batch)
            target = jax.tree.map(lambda leaf, part=part: leaf[..., part], targets)
            last = index == learner.policy_delay - 1
            after, _metrics = learner.improve(hyper, after, one, target, normal[part], last)
        return after_updates(state, after, hyper.average_step_size), None

    return jax.lax.scan(group, state, (drawn, noise))[0]
