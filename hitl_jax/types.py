"""Data that the rooms hand to each other; no behaviour."""

from typing import Any

import chex
from flax import struct

Params = Any
"""A pytree of float32 arrays."""


@struct.dataclass
class Transition:
    """One (n-step) transition of the task, as the task learner sees it.

    Shapes are for one transition; a minibatch has a leading axis B.

    Attributes:
        observation: s_t, [O].
        action: the executed action, [A], in [-1, 1].
        reward: sum of the n discounted rewards of equation (7), [].
        discount: γ^m · (1 − terminated), [], where m ≤ n steps were taken. A truncated episode
            keeps its bootstrap.
        next_observation: s_{t+m}, the true final observation where the episode ended, [O].
        human: 1 where the action is the human's, []; None: no step of the minibatch is. An
            episode's last step counts as the machine's.
    """

    observation: chex.Array
    action: chex.Array
    reward: chex.Array
    discount: chex.Array
    next_observation: chex.Array
    human: chex.Array | None = None


@struct.dataclass
class BoundaryTransition:
    """One sample of Algorithm 1's pool D: (s_t, s_{t+1}, r_t, τ_t, τ_{t+1}), line 9.

    Attributes:
        observation: s_t, [O].
        boundary: τ_t, [], in the safety indicator's unit.
        reward: r_t of equation (7) plus r'_t, [].
        discount: γ · (1 − terminated), [].
        next_observation: s_{t+1}, [O].
        next_boundary: τ_{t+1} of line 8, [].
        indicator: c_t, []; None where nobody looks at it.
        next_indicator: c_{t+1}, [], likewise.
        counts: 0 where the boundary decided nothing, [], likewise.
        boundary_reward: r'_t, [], likewise.
        explores: `Frame.explores` of the step, [], likewise.
    """

    observation: chex.Array
    boundary: chex.Array
    reward: chex.Array
    discount: chex.Array
    next_observation: chex.Array
    next_boundary: chex.Array
    indicator: chex.Array | None = None
    next_indicator: chex.Array | None = None
    counts: chex.Array | None = None
    boundary_reward: chex.Array | None = None
    explores: chex.Array | None = None


@struct.dataclass
class Outcome:
    """What followed a state within the risk critic's horizon, while the machine acted.

    Shapes are for one state; a minibatch has a leading axis B.

    Attributes:
        observation: s_t, [O].
        fell: 1 where the walker fell, [].
        cut_off: 1 where time was up or the human came before anything else had happened, [].
        last_observation: the state in which that was, [O].
        explores: `Frame.explores` of the step, [].
        counts: 0 where nothing can be learned from the state, [].
    """

    observation: chex.Array
    fell: chex.Array
    cut_off: chex.Array
    last_observation: chex.Array
    explores: chex.Array
    counts: chex.Array


@struct.dataclass
class LearnerState:
    """The task learner of one run.

    Attributes:
        actor: parameters of μ.
        critic: parameters of the stacked critics, leaves [E, ...].
        target_actor: Polyak average of `actor`.
        target_critic: Polyak average of `critic`.
        actor_optimizer: state of Adam for `actor`.
        critic_optimizer: state of Adam for `critic`.
    """

    actor: Params
    critic: Params
    target_actor: Params
    target_critic: Params
    actor_optimizer: Any
    critic_optimizer: Any


@struct.dataclass
class BoundaryState:
    """The boundary learner of one run (Algorithm 1, line 2).

    Attributes:
        actor: parameters θ of π_θ.
        critic: parameters ω of Q_ω.
        actor_optimizer: state of Adam for θ.
        critic_optimizer: state of Adam for ω.
        target_critic: Polyak average of `critic`; None where there are no targets.
    """

    actor: Params
    critic: Params
    actor_optimizer: Any
    critic_optimizer: Any
    target_critic: Params | None = None


@struct.dataclass
class RiskCritic:
    """What gives the risk of a state.

    Attributes:
        network: parameters of the network.
        slope: logarithm of what its logits are multiplied with, [].
        offset: what is added to them, [].
    """

    network: Params
    slope: chex.Array
    offset: chex.Array


@struct.dataclass
class RiskState:
    """The risk critic of one run, and its optimiser.

    Attributes:
        critic: what gives the risk.
        optimizer: state of Adam for `critic.network`.
    """

    critic: RiskCritic
    optimizer: Any


@struct.dataclass
class AveragedActor:
    """The Polyak average of μ over its updates.

    Attributes:
        params: of the average.
        updates: of μ so far, int32 [].
    """

    params: Params
    updates: chex.Array


@struct.dataclass
class TrainState:
    """All that learning changes in one run.

    Attributes:
        learner: the task learner.
        boundary: the boundary learner.
        key: typed PRNG key of the run's learning, [].
        risk: the risk critic; None in a team that does not look at it.
        average: of the actor; None where the last parameters are tested.
    """

    learner: LearnerState
    boundary: BoundaryState
    key: chex.PRNGKey
    risk: RiskState | None = None
    average: AveragedActor | None = None


@struct.dataclass
class Behavior:
    """The parameters that acting needs, and no others.

    Attributes:
        actor: parameters of μ.
        boundary_actor: parameters θ of π_θ.
        risk: what gives the risk of a state; None in a team that does not look at it.
    """

    actor: Params
    boundary_actor: Params
    risk: RiskCritic | None = None
