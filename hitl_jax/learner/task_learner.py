"""What a task learner is: the protocol that `team.agent` calls, and what it is made from."""

from typing import Any, Protocol

import chex

from hitl_jax.choices.checks import require_whole
from hitl_jax.choices.options import Option, options_of
from hitl_jax.learner.losses import Metrics
from hitl_jax.types import Params, Transition

State = Any
"""A dataclass of arrays: all that the task learner changes in a run.

Acting needs its field `actor`; of a trained run its fields `actor` (or its average, if that is
tested) and `critic` are saved."""


class Sizes(Protocol):
    """What a learner is made from: these fields of `hitl_jax.config.AgentConfig`."""

    @property
    def observation_size(self) -> int:
        """O."""

    @property
    def action_size(self) -> int:
        """A."""

    @property
    def hidden_sizes(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""

    @property
    def layer_norm(self) -> bool:
        """Whether the critics normalise their hidden layers."""

    @property
    def matmul_precision(self) -> str:
        """Of products between hidden layers."""

    @property
    def human_data(self) -> str:
        """What is made of the human's steps, a name in `human_data.HUMAN_DATA`."""


class TaskLearner(Protocol):
    """Learns the task from transitions: pure functions for one run, which the caller vmaps.

    An object must be hashable, and equal to another that computes the same, since programs are
    compiled once for equal objects: a frozen dataclass of what it was made from is.

    Attributes:
        policy_delay: updates to one for which `last` is true. The targets of so many updates are
            computed together, before the first of them.
        noise_size: standard normal numbers that `targets` and `improve` are given for each
            transition of a minibatch.
        options: traced numbers of its own; they are in `hyper.extra`, by name.

    One that can imitate the human has an attribute `human_data`, what `HUMAN_DATA.make` gives for
    `config.human_data`, and adds its `actor_loss(hyper.extra, action, batch)` to the actor's loss
    where it `changes_actor`, and its `critic_loss` to the critics' where it `changes_critic`.
    Beside a learner without the attribute such choices are refused.
    """

    def __hash__(self) -> int: ...

    @property
    def policy_delay(self) -> int:
        """See above."""

    @property
    def noise_size(self) -> int:
        """See above."""

    @property
    def options(self) -> tuple[Option, ...]:
        """See above."""

    def init(self, actor_key: chex.PRNGKey, critic_key: chex.PRNGKey) -> State:
        """The state at the start of a run; both keys are consumed."""

    def with_networks(self, state: State, actor: Params, critic: Params) -> State:
        """A state that goes on from saved networks."""

    def act(
        self, hyper: Any, actor: Params, observation: chex.Array, noise: chex.Array, scale: Any
    ) -> chex.Array:
        """An action, to be clipped to [-1, 1] by the caller.

        Args:
            hyper: the run's hyperparameters, scalars.
            actor: `state.actor`.
            observation: s_t, [O].
            noise: standard normal, correlated over the steps of an episode, [A].
            scale: `hyper.exploration_noise`; 0 where the best action is asked for, without noise.

        Returns:
            The action, [A].
        """

    def targets(
        self, hyper: Any, state: State, batch: Transition, noise: chex.Array
    ) -> chex.ArrayTree:
        """TD targets of minibatches.

        Args:
            hyper: the run's hyperparameters, scalars.
            state: before the updates that share them.
            batch: leading axis B.
            noise: standard normal, [B, noise_size].

        Returns:
            The targets, leaves [..., B].
        """

    def improve(
        self,
        hyper: Any,
        state: State,
        batch: Transition,
        target: chex.ArrayTree,
        noise: chex.Array,
        last: bool,
    ) -> tuple[State, Metrics]:
        """One update.

        Args:
            hyper: the run's hyperparameters, scalars.
            state: before the update.
            batch: minibatch, leading axis B.
            target: its targets, leaves [..., B].
            noise: what the targets were computed with, [B, noise_size].
            last: static; True at one update in `policy_delay`, the last that shares its targets.

        Returns:
            The next state and metrics, each one real number []. A metric is a column of
            `diagnostics.csv`: its name is of a to z, 0 to 9 and _, and none of the counters'
            (`updates`, `env_steps`, `episodes`) or the boundary learner's (`boundary_...`,
            `network_boundary...`).
        """


NEEDS = (
    "policy_delay",
    "noise_size",
    "options",
    "init",
    "with_networks",
    "act",
    "targets",
    "improve",
)
"""What an object must have to be a task learner."""


def require_usable(learner: TaskLearner) -> None:
    """Checks what a learner says of itself.

    Raises:
        InvalidValue: one line with the attribute, its value and what is allowed.
    """
    require_whole("policy_delay", learner.policy_delay, at_least=1)
    require_whole("noise_size", learner.noise_size)
    options_of(learner)
