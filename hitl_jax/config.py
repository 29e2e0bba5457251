"""What a run is made of: static choices, traced hyperparameters, and their validation.

A static choice (`AgentConfig`) changes the compiled program. A traced hyperparameter (`Hyper`) is a
number that the program takes as an argument, so that one program can sweep it along the run axis.
"""

import dataclasses
import enum
import itertools
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

import hitl_jax.tasks  # noqa: F401  # Registers what they bring.
from hitl_jax.arbiter import FEEDBACK_SCHEDULES, INTERVENTIONS, RELEASES
from hitl_jax.boundary import BOUNDARY_LEARNERS, SOURCES
from hitl_jax.boundary.margin import MARGIN_PARTS
from hitl_jax.choices.checks import is_whole, require_whole
from hitl_jax.choices.fields import (
    among,
    checked_by,
    choice,
    choices,
    described,
    flag,
    nested,
    number,
    require_fields,
    some_of,
    whole,
)
from hitl_jax.choices.options import require_names
from hitl_jax.errors import InvalidValue, name_of
from hitl_jax.human import (
    ALL_PARTS,
    DANGER_MODELS,
    HUMAN_PARTS,
    MAX_DELAY,
    HumanParams,
    validate_human_params,
)
from hitl_jax.human.actions import ACTION_SOURCES
from hitl_jax.human.indicator import INDICATORS
from hitl_jax.learner.algorithms import LEARNERS
from hitl_jax.learner.human_data import HUMAN_DATA
from hitl_jax.learner.task_learner import TaskLearner
from hitl_jax.xla.dense_product import MATMUL_PRECISIONS

LAST, AVERAGE = "last", "average"  # Of `AgentConfig.tested_actor`.
_MOST_UNITS = 2**20
_MOST_LAYERS = 16
_MOST_WEIGHTS = 2**26


class Method(enum.StrEnum):
    """The three methods that the paper compares; they differ by the boundary alone."""

    SRL = "srl"
    HITL_FIX = "hitl-fix"
    HITL_AC = "hitl-ac"


def _require_layers(name: str, sizes: Any) -> None:
    """Checks widths of hidden layers; InvalidValue names field, value and what is allowed."""
    if not isinstance(sizes, tuple):
        raise InvalidValue(name, name_of(sizes), "must be a tuple of widths")
    if not sizes or any(not is_whole(size) or size < 1 for size in sizes):
        raise InvalidValue(name, sizes, "at least one layer, each of 1 or more")
    for size in sizes:
        require_whole(name, size, at_most=_MOST_UNITS)
    if len(sizes) > _MOST_LAYERS:
        raise InvalidValue(name, f"{len(sizes)} layers", f"at most {_MOST_LAYERS}")
    if any(a * b > _MOST_WEIGHTS for a, b in itertools.pairwise(sizes)):
        raise InvalidValue(name, sizes, f"at most {_MOST_WEIGHTS} weights each")


@described
@dataclasses.dataclass(frozen=True)
class AgentConfig:
    """Static choices: another value means another compiled program.

    A choice is a registered name, or `module:name` of one of your own, which is imported when a
    team is made.

    Attributes:
        learner: the task learner:
        hidden_sizes: widths of the task networks' hidden layers.
        layer_norm: whether the task critics normalise their hidden layers.
        matmul_precision: how the task learner multiplies between hidden layers: `float32`, or
            `bfloat16`, which is faster on CPUs with AVX512-BF16 and may end a little lower. Sums,
            parameters and acting stay float32.
        human_data: what the task learner makes of the human's steps:
        tested_actor: which parameters of μ are tested and kept: `last`, those that the last update
            left, or `average`, their Polyak average. In training the last ones act in any case.
        batch_size: transitions in a minibatch of the task learner.
        n_step: steps of reward before the bootstrap.
        boundary_source: how line 6 and line 8 of Algorithm 1 meet:
        boundary_learner: how lines 10 to 12 learn:
        margin_parts: what the boundary learner `margin` is made of:
        boundary_hidden_sizes: widths of the boundary networks' hidden layers.
        boundary_batch_size: samples in a minibatch of the boundary learner.
        risk_hidden_sizes: widths of the risk critic's hidden layers.
        risk_batch_size: states in a minibatch of the risk critic.
        risk_horizon: a state's risk is the probability of a fall within so many steps of the
            machine's.
        indicator: the safety indicator c_t:
        danger: the simulated human's test of danger:
        human_parts: what stands between danger and the human's judgement, in this order:
        human_actions: what the human does with the controls:
        intervention: what a human intervention does:
        release: what ends a takeover:
        feedback_schedule: when r(s, a^h) is given:
        human_reset_terminates: whether a human reset ends the bootstrap.
        observation_size: length of an observation.
        action_size: length of an action.
    """

    learner: str = choice("td3-tqc", LEARNERS)
    hidden_sizes: tuple[int, ...] = checked_by((128, 128), _require_layers)
    layer_norm: bool = flag(True)
    matmul_precision: str = among("float32", MATMUL_PRECISIONS)
    human_data: str = choice("imitation", HUMAN_DATA)
    tested_actor: str = among(AVERAGE, (LAST, AVERAGE))
    batch_size: int = whole(64, 1, _MOST_UNITS)
    n_step: int = whole(4, 1, _MOST_UNITS)
    boundary_source: str = choice("network", SOURCES)
    boundary_learner: str = choice("margin", BOUNDARY_LEARNERS)
    margin_parts: tuple[str, ...] = some_of(MARGIN_PARTS)
    boundary_hidden_sizes: tuple[int, ...] = checked_by((64, 64), _require_layers)
    boundary_batch_size: int = whole(64, 1, _MOST_UNITS)
    risk_hidden_sizes: tuple[int, ...] = checked_by((64, 64), _require_layers)
    risk_batch_size: int = whole(64, 1, _MOST_UNITS)
    risk_horizon: int = whole(50, 1, _MOST_UNITS, unit="steps")
    indicator: str = choice("hull_angle", INDICATORS)
    danger: str = choice("experienced", DANGER_MODELS)
    human_parts: tuple[str, ...] = choices(ALL_PARTS, HUMAN_PARTS)
    human_actions: str = choice("trained", ACTION_SOURCES)
    intervention: str = choice("takeover", INTERVENTIONS)
    release: str = choice("judgement", RELEASES)
    feedback_schedule: str = choice("onset", FEEDBACK_SCHEDULES)
    human_reset_terminates: bool = flag(True)
    observation_size: int = whole(24, 1, _MOST_UNITS)
    action_size: int = whole(4, 1, _MOST_UNITS)

    def __post_init__(self) -> None:
        """Checks every field; InvalidValue names it, its value and what is allowed."""
        for name, value in vars(self).items():
            if isinstance(value, list):  # As JSON has them; programs are kept by hashable choices.
                object.__setattr__(self, name, tuple(value))
        require_fields(self)
        if self.matmul_precision != "float32" and len(self.hidden_sizes) < 2:
            why = "is for products between hidden layers, and hidden_sizes "
            why += f"{self.hidden_sizes} has one: must be float32"
            raise InvalidValue("matmul_precision", self.matmul_precision, why, ("hidden_sizes",))

    @property
    def task_learner(self) -> TaskLearner:
        """What the learner's name stands for."""
        return LEARNERS.make(self.learner, self)


@described
@struct.dataclass
class Hyper:
    """Traced hyperparameters of one run; every field is a scalar, or [R] for a batch of runs.

    Attributes:
        actor_learning_rate: Adam's step size for μ.
        critic_learning_rate: Adam's step size for Q.
        target_step_size: Polyak step of the targets, a share an update of the actor; of the
            boundary critic's, an update of that.
        average_step_size: Polyak step of the averaged actor, a share an update of the actor.
        gamma: discount of one environment step.
        target_noise: standard deviation of TD3's target smoothing, in units of action.
        target_noise_clip: bound of that noise.
        exploration_noise: standard deviation of the action noise, in units of action.
        noise_steps: environment steps over which the action noise fades evenly to `final_noise`,
            however long the run is; 0 keeps it as it is.
        final_noise: what the noise has faded to, a standard deviation in units of action.
        noise_correlation: correlation of the action noise from step to step; 0 is white. The noise
            starts from 0 in every episode.
        noise_free_every: of so many training episodes the last is played without action noise, as
            the test will be; 0 is none. What is learned of the risk and of alarms without noise
            comes from these.
        unattended_every: of so many training episodes the last is walked without the human, as the
            test will be: no alarm is raised; 0 is none.
        warmup_steps: environment steps of uniformly random actions before learning.
        initial_boundary: τ_0. This, Δ⁻, Δ⁺, the bounds and the noise of the boundary are in the
            safety indicator's unit: rad with the hull's angle, a probability with `fall_risk`.
        delta_minus: Δ⁻, what a true alarm takes from the boundary.
        delta_plus: Δ⁺, what a false alarm adds to it; the gain of `quantile` and `pid`.
        target_rate: what `quantile` and `pid` aim at, a share of the steps.
        boundary_low: least boundary.
        boundary_high: greatest boundary.
        boundary_noise: standard deviation of the exploration of π_θ; with `margin` the scale of
            Cauchy's.
        boundary_temperature: with `margin`, what the entropy of the alarm is worth to line 12, in
            units of the reward; 0 is nothing.
        boundary_actor_learning_rate: α^θ.
        boundary_critic_learning_rate: α^ω.
        risk_learning_rate: Adam's step size for the risk critic.
        alarm_reward: ρ, the size of r'_t.
        human_price: p, what r'_t of an alarm is less by if the human confirms it: the price of the
            human's coming. `margin` pays it once a takeover, `printed` at each of its steps with
            an alarm. It must leave r'_t above 0: by that a confirmed alarm is known.
        reward_weight: what r(s, a) counts in what is learned from; 0 leaves the human's feedback
            alone, as in RLIF (https://arxiv.org/abs/2311.12996).
        feedback: r(s, a^h), negative for a punishment. Given once, at the first step of an
            intervention, unless the schedule says otherwise: with `step` a takeover of fifty steps
            pays it fifty times.
        takeover_steps: least number of steps that a takeover lasts.
        release_share: with hysteresis, the share of the boundary below which a takeover ends.
        human_action_noise: standard deviation of the noise on a^h.
        human: the simulated human's parameters.
        extra: numbers of single choices, by name: `imitation_weight` (10), `proxy_value` (1), and
            those of choices of one's own.
    """

    actor_learning_rate: float = number(1e-3, 0.0)
    critic_learning_rate: float = number(1e-3, 0.0)
    target_step_size: float = number(0.005, 0.0, 1.0, unit="1")
    average_step_size: float = number(0.001, 0.0, 1.0, unit="1")
    gamma: float = number(0.98, 0.0, 1.0, unit="1")
    target_noise: float = number(0.2, 0)
    target_noise_clip: float = number(0.5, 0)
    exploration_noise: float = number(0.3, 0)
    noise_steps: int = whole(300_000, unit="steps")
    final_noise: float = number(0.0, 0)
    noise_correlation: float = number(0.8, 0.0, 0.999, unit="1")
    noise_free_every: int = whole(2)
    unattended_every: int = whole(4)
    warmup_steps: int = whole(2000)
    initial_boundary: float = number(0.7)
    delta_minus: float = number(1e-3, 0)
    delta_plus: float = number(1e-3, 0)
    target_rate: float = number(1e-3, 0.0, 1.0, unit="1")
    boundary_low: float = number(0.0, 0.0)
    boundary_high: float = number(1.5)
    boundary_noise: float = number(0.1, 0)
    boundary_temperature: float = number(10.0, 0)
    boundary_actor_learning_rate: float = number(1e-4, 0.0)
    boundary_critic_learning_rate: float = number(1e-3, 0.0)
    risk_learning_rate: float = number(3e-4, 0.0)
    alarm_reward: float = number(15.0, 0)
    human_price: float = number(0.0, 0)
    reward_weight: float = number(1.0, 0.0)
    feedback: float = number(-10.0)
    takeover_steps: int = whole(50, 1, unit="steps")
    release_share: float = number(0.5, 0.0, 1.0, unit="1")
    human_action_noise: float = number(0.0, 0)
    human: HumanParams = nested(HumanParams, lambda name, value: None)
    extra: dict[str, float] = nested(dict, require_names)


@struct.dataclass
class RunHyper(Hyper):
    """The hyperparameters of one run of one method: what the pure functions take.

    Attributes:
        has_arbiter: 1 where an arbiter and a human are in the loop (HITL-FIX, HITL-AC).
        learns_boundary: 1 where the boundary is learned (HITL-AC).
        human_present: 1 where the human may intervene; 0 in an autonomous test, where alarms and
            judgements are recorded but nothing follows from them.
    """

    has_arbiter: float = number(1.0, 0.0, 1.0)
    learns_boundary: float = number(1.0, 0.0, 1.0)
    human_present: float = number(1.0, 0.0, 1.0)


def typed(hyper: RunHyper) -> RunHyper:
    """Host scalars of the types that the defaults have, whatever a caller wrote (1 for 1.0)."""
    return _cast(hyper, np.asarray, np)


def traced(hyper: RunHyper) -> RunHyper:
    """The same as arrays of the types of `typed`, whatever JAX would make of a caller's numbers."""
    return _cast(hyper, jnp.asarray, jnp)


def _cast(hyper: RunHyper, asarray: Any, types: Any) -> RunHyper:
    """Hyperparameters as int32 where the default is whole, else as float32."""
    human = HumanParams(extra=dict.fromkeys(hyper.human.extra, 0.0))
    like = RunHyper(human=human, extra=dict.fromkeys(hyper.extra, 0.0))

    def cast(default: float, value: chex.Numeric) -> chex.Array:
        return asarray(value, types.int32 if isinstance(default, int) else types.float32)

    return jax.tree.map(cast, like, hyper)


def as_float32(tree: chex.ArrayTree) -> chex.ArrayTree:
    """Arrays of a caller's in the type of all arithmetic here, whatever JAX is configured to."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)


def hyper_for(method: Method, hyper: Hyper) -> RunHyper:
    """The hyperparameters of `method`: equal for the three in everything but the flags."""
    common = {field.name: getattr(hyper, field.name) for field in dataclasses.fields(Hyper)}
    return RunHyper(
        **common,
        has_arbiter=float(method is not Method.SRL),
        learns_boundary=float(method is Method.HITL_AC),
    )


def validate_hyper(hyper: Hyper, max_delay: int = MAX_DELAY) -> None:
    """Checks host values before any work starts.

    Args:
        hyper: scalars, not yet on a device.
        max_delay: longest reaction delay that the human was made for [steps].

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    require_fields(hyper)
    low, first, high = hyper.boundary_low, hyper.initial_boundary, hyper.boundary_high
    if not low <= high:
        why = f"must be at least boundary_low {low:g}"
        raise InvalidValue("boundary_high", high, why, mentions=("boundary_low",))
    if not low <= first <= high:
        why = f"must be at least boundary_low {low:g} and at most boundary_high {high:g}"
        raise InvalidValue("initial_boundary", first, why, ("boundary_low", "boundary_high"))
    pays = np.float32(hyper.alarm_reward) > np.float32(hyper.human_price)
    if hyper.human_price and not pays:
        why = f"must be less than alarm_reward {hyper.alarm_reward:g}"
        raise InvalidValue("human_price", hyper.human_price, why, mentions=("alarm_reward",))
    validate_human_params(hyper.human, max_delay)
