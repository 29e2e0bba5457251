"""`Agent`: the parts of a team, and what follows from them."""

import dataclasses
import functools
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import optax

from hitl_jax.arbiter import Intervention
from hitl_jax.arbiter.releases import Release
from hitl_jax.boundary import BoundaryLearner, BoundarySource
from hitl_jax.choices.options import Option, all_options, completed
from hitl_jax.config import LAST, AgentConfig, as_float32
from hitl_jax.human import HumanPart
from hitl_jax.human.actions import ActionSource
from hitl_jax.human.indicator import Indicator, does_see_risk
from hitl_jax.learner import replay
from hitl_jax.learner.frame import Layout
from hitl_jax.learner.human_data import HUMAN_DATA, HumanData
from hitl_jax.learner.task_learner import TaskLearner
from hitl_jax.risk import RiskLearner
from hitl_jax.types import AveragedActor, Behavior, BoundaryTransition, Params, TrainState


class Agent(NamedTuple):
    """The parts of the team, each a choice of one interface; `make_agent` puts them together.

    Attributes:
        config: static choices.
        indicator: c_t of an observation.
        human: the judgement h_t.
        source: the human's actions a^h.
        learner: the task learner.
        boundary_source: where τ_t comes from.
        boundary_learner: π_θ and Q_ω.
        intervention: what an intervention does.
        release: what ends a takeover.
    """

    config: AgentConfig
    indicator: Indicator
    human: HumanPart
    source: ActionSource
    learner: TaskLearner
    boundary_source: BoundarySource
    boundary_learner: BoundaryLearner
    intervention: Intervention
    release: Release

    @property
    def human_data(self) -> HumanData:
        """What the task learner makes of the human's steps."""
        return HUMAN_DATA.make(self.config.human_data)

    @property
    def executes_actor(self) -> bool:
        """Whether τ_t comes from π_θ(s_t)."""
        return self.boundary_source.executes_actor

    @property
    def risk_learner(self) -> RiskLearner | None:
        """The risk critic's; None where no part looks at the risk."""
        config = self.config
        if not does_see_risk(self.indicator):
            return None
        return RiskLearner(
            config.observation_size,
            config.risk_hidden_sizes,
            config.risk_horizon,
            config.risk_batch_size,
        )

    def safety_indicator(self, params: Behavior | None, observation: chex.Array) -> chex.Array:
        """c_t of one state, [].

        Args:
            params: what acting needs of the run's parameters; None will do where the indicator does
                not see the risk.
            observation: s_t, [O].
        """
        learner = self.risk_learner
        if learner is None:
            return self.indicator(observation)
        assert params is not None and params.risk is not None
        return self.indicator(observation, learner.risk(params.risk, observation))

    def draw_boundary(
        self,
        hyper: Any,
        state: TrainState,
        memory: replay.Replay,
        column: chex.Array,
        key: chex.PRNGKey,
        size: int | None = None,
    ) -> BoundaryTransition:
        """Samples of the pool D (line 10), with the safety indicator as it is now.

        Args:
            hyper: the run's hyperparameters, scalars.
            state: the run's training state.
            memory: the replay.
            column: the run's column, int32 [].
            key: consumed.
            size: N; None is the team's.
        """
        size = self.config.boundary_batch_size if size is None else size
        pool = self.boundary_learner.draw(memory, self.layout, column, key, size, hyper.gamma)
        indicator = jax.vmap(functools.partial(self.safety_indicator, behavior(state)))
        return dataclasses.replace(
            pool,
            indicator=as_float32(indicator(pool.observation)),
            next_indicator=as_float32(indicator(pool.next_observation)),
        )

    @property
    def layout(self) -> Layout:
        """Columns of a frame in replay."""
        return Layout(self.config.observation_size, self.config.action_size)

    @property
    def options(self) -> dict[str, Option]:
        """What `Hyper.extra` can hold for this team, by name: options of all that is told of it."""
        parts = self.learner, self.human_data, self.boundary_source, self.intervention, self.release
        return all_options(parts)

    def with_extra(self, hyper: Any) -> Any:
        """Hyperparameters with the defaults of what the choices' own options are not given.

        Args:
            hyper: `Hyper` or `RunHyper`, of numbers on the host or traced; not checked.
        """
        extra = completed(hyper.extra, self.options)
        of_human = completed(hyper.human.extra, all_options([self.human]))
        return dataclasses.replace(
            hyper, extra=extra, human=dataclasses.replace(hyper.human, extra=of_human)
        )


def first_average(config: AgentConfig, actor: Params) -> AveragedActor | None:
    """The averaged actor before the first update; None where the last parameters are tested."""
    if config.tested_actor == LAST:
        return None
    return AveragedActor(params=actor, updates=jnp.zeros((), jnp.int32))


def after_updates(state: TrainState, learner: Any, step: chex.Numeric) -> TrainState:
    """A run's state after updates of the task learner of which the last has improved the actor.

    The averaged actor moves by `step`, and while it has seen few updates so far that all count
    alike: what the first, random parameters were leaves no trace.

    Args:
        state: before them.
        learner: the task learner's state after them.
        step: `hyper.average_step_size`, [].
    """
    average = state.average
    if average is not None:
        updates = average.updates + 1
        share = jnp.maximum(step, 1.0 / updates.astype(jnp.float32))
        params = optax.incremental_update(learner.actor, average.params, share)
        average = AveragedActor(params=params, updates=updates)
    return dataclasses.replace(state, learner=learner, average=average)


def as_tested(state: TrainState) -> TrainState:
    """A run's state with what is tested and kept as μ, see `AgentConfig.tested_actor`."""
    if state.average is None:
        return state
    learner = dataclasses.replace(state.learner, actor=state.average.params)
    return dataclasses.replace(state, learner=learner)


def behavior(state: TrainState) -> Behavior:
    """The part of a run's state that acting needs."""
    return Behavior(
        actor=state.learner.actor,
        boundary_actor=state.boundary.actor,
        risk=None if state.risk is None else state.risk.critic,
    )
