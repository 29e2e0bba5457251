"""What a run is made of: static choices, traced hyperparameters, and their validation.

A static choice (`AgentConfig`) changes the compiled program. A traced hyperparameter (`Hyper`) is a
number that the program takes as an argument, so that one program can sweep it along the run axis.
"""

import dataclasses
import enum
import itertools

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from hitl_jax.choices.checks import MOST, is_whole, one_of, require, require_whole
from hitl_jax.errors import InvalidValue
from hitl_jax.human.indicator import INDICATORS
from hitl_jax.human.judgement import DANGER_MODELS, MAX_DELAY, HumanParams, validate_human_params
from hitl_jax.learner.algorithms import LEARNERS, Learner
from hitl_jax.xla.dense_product import MATMUL_PRECISIONS

BOUNDARY_SOURCES = ("network", "residual", "rule", "quantile", "pid")
INTERVENTIONS = ("reset", "takeover", "penalty")
RELEASES = ("judgement", "hysteresis")
FEEDBACK_SCHEDULES = ("step", "episode")

_MOST_UNITS = 2**20
_MOST_LAYERS = 16
_MOST_WEIGHTS = 2**26


class Method(enum.StrEnum):
    """The three methods that the paper compares; they differ by the boundary alone."""

    SRL = "srl"
    HITL_FIX = "hitl-fix"
    HITL_AC = "hitl-ac"


@dataclasses.dataclass(frozen=True)
class AgentConfig:
    """Static choices: another value means another compiled program.

    Attributes:
        learner: `ddpg` (one critic, plain target), `td3` (two, smoothed target, delayed actor) or
            `td3-tqc` (as `td3`, the critics learn quantiles of the return).
        hidden_sizes: widths of the task networks' hidden layers.
        layer_norm: whether the task critics normalise their hidden layers.
        matmul_precision: how the task learner multiplies between hidden layers: `float32`, or
            `bfloat16`, which is faster on CPUs with AVX512-BF16 and may end a little lower. Sums,
            parameters and acting stay float32.
        batch_size: transitions in a minibatch of the task learner.
        n_step: steps of reward before the bootstrap.
        boundary_source: how line 6 and line 8 of Algorithm 1 meet: `network`, `residual`, `rule`.
            With `residual` the actor is improved at its own output, as line 12 has it, not at the
            executed sum. To compare with: `quantile` holds the share of alarms at a target, `pid`
            the share of steps under human control.
        boundary_hidden_sizes: widths of the boundary networks' hidden layers.
        boundary_batch_size: samples in a minibatch of the boundary learner.
        indicator: name of the safety indicator c_t.
        danger: the simulated human's test of danger: `threshold` or `predictive`.
        intervention: what a human intervention does: `reset`, `takeover`, `penalty`.
        release: what ends a takeover: the human's `judgement` that the state is safe, or
            `hysteresis`, |c_t| below a share of the boundary (as LazyDAgger,
            https://arxiv.org/abs/2104.00053).
        feedback_schedule: r(s, a^h) at each intervened `step`, or once an `episode`, at its end.
        human_reset_terminates: whether a human reset ends the bootstrap.
        observation_size: length of an observation.
        action_size: length of an action.
    """

    learner: str = "td3-tqc"
    hidden_sizes: tuple[int, ...] = (128, 128)
    layer_norm: bool = True
    matmul_precision: str = "float32"
    batch_size: int = 64
    n_step: int = 4
    boundary_source: str = "rule"
    boundary_hidden_sizes: tuple[int, ...] = (32, 32)
    boundary_batch_size: int = 64
    indicator: str = "hull_angle"
    danger: str = "threshold"
    intervention: str = "reset"
    release: str = "judgement"
    feedback_schedule: str = "step"
    human_reset_terminates: bool = True
    observation_size: int = 24
    action_size: int = 4

    def __post_init__(self) -> None:
        """Checks every choice; InvalidValue names it, its value and what is allowed."""
        one_of("learner", self.learner, tuple(LEARNERS))
        one_of("matmul_precision", self.matmul_precision, MATMUL_PRECISIONS)
        one_of("boundary_source", self.boundary_source, BOUNDARY_SOURCES)
        one_of("indicator", self.indicator, tuple(INDICATORS))
        one_of("danger", self.danger, tuple(DANGER_MODELS))
        one_of("intervention", self.intervention, INTERVENTIONS)
        one_of("release", self.release, RELEASES)
        one_of("feedback_schedule", self.feedback_schedule, FEEDBACK_SCHEDULES)
        for name in (
            "batch_size",
            "n_step",
            "boundary_batch_size",
            "observation_size",
            "action_size",
        ):
            require_whole(name, getattr(self, name), at_least=1, at_most=_MOST_UNITS)
        for name in ("hidden_sizes", "boundary_hidden_sizes"):
            sizes = getattr(self, name)
            if not sizes or any(not is_whole(size) or size < 1 for size in sizes):
                raise InvalidValue(name, sizes, "at least one layer, each of 1 or more")
            for size in sizes:
                require_whole(name, size, at_most=_MOST_UNITS)
            if len(sizes) > _MOST_LAYERS:
                raise InvalidValue(name, f"{len(sizes)} layers", f"at most {_MOST_LAYERS}")
            if any(a * b > _MOST_WEIGHTS for a, b in itertools.pairwise(sizes)):
                raise InvalidValue(name, sizes, f"at most {_MOST_WEIGHTS} weights each")
        if self.matmul_precision != "float32" and len(self.hidden_sizes) < 2:
            raise InvalidValue(
                "matmul_precision",
                self.matmul_precision,
                f"is for products between hidden layers, and hidden_sizes {self.hidden_sizes} "
                "has one: must be float32",
                mentions=("hidden_sizes",),
            )

    @property
    def task_learner(self) -> Learner:
        """What the learner's name stands for."""
        return LEARNERS[self.learner]


@struct.dataclass
class Hyper:
    """Traced hyperparameters of one run; every field is a scalar, or [R] for a batch of runs.

    Attributes:
        actor_learning_rate: Adam's step size for μ.
        critic_learning_rate: Adam's step size for Q.
        target_step_size: Polyak step of the targets, a share a step.
        gamma: discount of one environment step.
        target_noise: standard deviation of TD3's target smoothing, in units of action.
        target_noise_clip: bound of that noise.
        exploration_noise: standard deviation of the action noise, in units of action.
        noise_correlation: correlation of the action noise from step to step; 0 is white. The noise
            starts from 0 in every episode.
        noise_free_every: of so many training episodes the last is played without action noise, as
            the test will be; 0 is none.
        warmup_steps: environment steps of uniformly random actions before learning.
        initial_boundary: τ_0 [rad].
        delta_minus: Δ⁻, what a true alarm takes from the boundary [rad].
        delta_plus: Δ⁺, what a false alarm adds to it [rad]; the gain of `quantile` and `pid`.
        target_rate: what `quantile` and `pid` aim at, a share of the steps [1].
        boundary_low: least boundary [rad].
        boundary_high: greatest boundary [rad].
        boundary_noise: standard deviation of the exploration of π_θ [rad].
        boundary_actor_learning_rate: α^θ.
        boundary_critic_learning_rate: α^ω.
        alarm_reward: ρ, the size of r'_t.
        feedback: r(s, a^h), negative for a punishment. Given at every step of an intervention
            unless the schedule says otherwise: a takeover of ten steps pays it ten times.
        takeover_steps: least number of steps that a takeover lasts.
        release_share: with hysteresis, the share of the boundary below which a takeover ends [1].
        human_action_noise: standard deviation of the noise on a^h.
        human: the simulated human's parameters.
    """

    actor_learning_rate: float = 1e-3
    critic_learning_rate: float = 1e-3
    target_step_size: float = 0.005
    gamma: float = 0.98
    target_noise: float = 0.2
    target_noise_clip: float = 0.5
    exploration_noise: float = 0.3
    noise_correlation: float = 0.8
    noise_free_every: int = 4
    warmup_steps: int = 2000
    initial_boundary: float = 0.7
    delta_minus: float = 1e-3
    delta_plus: float = 1e-3
    target_rate: float = 1e-3
    boundary_low: float = 0.05
    boundary_high: float = 1.5
    boundary_noise: float = 0.02
    boundary_actor_learning_rate: float = 1e-4
    boundary_critic_learning_rate: float = 1e-3
    alarm_reward: float = 1.0
    feedback: float = -20.0
    takeover_steps: int = 10
    release_share: float = 0.5
    human_action_noise: float = 0.0
    human: HumanParams = struct.field(default_factory=HumanParams)


@struct.dataclass
class RunHyper(Hyper):
    """The hyperparameters of one run of one method: what the pure functions take.

    Attributes:
        has_arbiter: 1 where an arbiter and a human are in the loop (HITL-FIX, HITL-AC).
        learns_boundary: 1 where the boundary is learned (HITL-AC).
        human_present: 1 where the human may intervene; 0 in an autonomous test, where alarms and
            judgements are recorded but nothing follows from them.
    """

    has_arbiter: float = 1.0
    learns_boundary: float = 1.0
    human_present: float = 1.0


def typed(hyper: RunHyper) -> RunHyper:
    """Host scalars of the types that the defaults have, whatever a caller wrote (1 for 1.0)."""

    def cast(default: float, value: float) -> np.ndarray:
        return np.asarray(value, np.int32 if isinstance(default, int) else np.float32)

    return jax.tree.map(cast, RunHyper(), hyper)


def traced(hyper: RunHyper) -> RunHyper:
    """The same as arrays of the types of `typed`, whatever JAX would make of a caller's numbers."""

    def cast(default: float, value: chex.Numeric) -> chex.Array:
        return jnp.asarray(value, jnp.int32 if isinstance(default, int) else jnp.float32)

    return jax.tree.map(cast, RunHyper(), hyper)


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
    for name in (
        "actor_learning_rate",
        "critic_learning_rate",
        "boundary_actor_learning_rate",
        "boundary_critic_learning_rate",
    ):
        require(name, getattr(hyper, name), at_least=0.0)
    for name in (
        "target_noise",
        "target_noise_clip",
        "exploration_noise",
        "delta_minus",
        "delta_plus",
        "boundary_noise",
        "alarm_reward",
        "human_action_noise",
    ):
        require(name, getattr(hyper, name), at_least=0)
    for name in ("gamma", "target_step_size", "target_rate", "release_share"):
        require(name, getattr(hyper, name), at_least=0.0, at_most=1.0)
    require("noise_correlation", hyper.noise_correlation, at_least=0.0, at_most=0.999)
    for name, least in (("noise_free_every", 0), ("warmup_steps", 0), ("takeover_steps", 1)):
        require_whole(name, getattr(hyper, name), at_least=least, at_most=MOST)
    require("feedback", hyper.feedback)
    require("boundary_low", hyper.boundary_low, at_least=0.0)
    require("boundary_high", hyper.boundary_high, at_least=hyper.boundary_low)
    require(
        "initial_boundary",
        hyper.initial_boundary,
        at_least=hyper.boundary_low,
        at_most=hyper.boundary_high,
    )
    validate_human_params(hyper.human, max_delay)
