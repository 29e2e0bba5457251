"""Losses, values and gradients of both learners of a run, on a sample of its replay.

They are computed apart from the updates, by a program of their own: the numbers of a run do not
depend on them.
"""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.config import RunHyper, traced
from hitl_jax.human import caller_state
from hitl_jax.learner import replay
from hitl_jax.learner.losses import Metrics
from hitl_jax.results.diagnostic_table import require_measured
from hitl_jax.team.parts import Agent
from hitl_jax.types import TrainState

SAMPLE = 256
"""Transitions of a sample. One in a thousand updates of 64 costs half a percent of them."""

EVERY = 1000
"""Updates of the task learner between two samples."""

_TAKEN = ("boundary_", "network_boundary", "risk_")
"""Names of what is measured of the boundary learner and of the risk critic begin so."""

_REAL = (np.floating, np.integer, np.bool_)

_FOLDED = 2**31 - 1
"""What the run's key is folded with: no key that `learn` splits off it is made of this number."""


def require_metrics(metrics: Any) -> None:
    """Checks what a task learner measures, so that no run is lost by what is measured of it.

    Args:
        metrics: as `improve` gives them, or their shapes.

    Raises:
        ValueError: one line, for a name that can be no column or is not a learner's to give, and
            for a metric that is no real number.
    """
    if not isinstance(metrics, dict):
        raise ValueError(f"metrics must be a dict of numbers, are {caller_state.form(metrics)}")
    require_measured(metrics)
    for name, value in metrics.items():
        if name.startswith(_TAKEN):
            raise ValueError(f"metric {name!r}: is a name for the boundary's or the risk's learner")
        scalar = getattr(value, "shape", None) == ()
        if not (scalar and any(jnp.issubdtype(value.dtype, kind) for kind in _REAL)):
            raise ValueError(f"metric {name!r}: must be a number, is {caller_state.form(value)}")


def diagnose(
    agent: Agent, hyper: RunHyper, state: TrainState, memory: replay.Replay, column: chex.Array
) -> Metrics:
    """Metrics of all learners on a sample of the replay; changes nothing.

    Those of the boundary learner are NaN where no boundary is learned, those of the risk critic
    where there is no arbiter.

    Args:
        agent: the team.
        hyper: the run's hyperparameters, scalars.
        state: the run's training state; its key is not consumed.
        memory: the replay.
        column: the run's column, int32 [].

    Returns:
        What `improve` of each learner measures, each [], and the mean and standard deviation of
        π_θ(s) as `network_boundary` and `network_boundary_spread`.
    """
    hyper, learner = traced(agent.with_extra(hyper)), agent.learner
    draw_key, noise_key, pool_key = jax.random.split(jax.random.fold_in(state.key, _FOLDED), 3)
    drawn = replay.draw(
        memory, agent.layout, column, draw_key, SAMPLE, agent.config.n_step, hyper.gamma
    )
    batch = replay.read(memory, agent.layout, column, drawn)
    noise = jax.random.normal(noise_key, (SAMPLE, learner.noise_size), jnp.float32)
    target = learner.targets(hyper, state.learner, batch, noise)
    _, metrics = learner.improve(hyper, state.learner, batch, target, noise, True)
    pool = agent.draw_boundary(hyper, state, memory, column, pool_key, SAMPLE)
    _, of_boundary = agent.boundary_learner.improve(hyper, state.boundary, pool)
    network = agent.boundary_learner.boundary(hyper, state.boundary.actor, pool.observation)
    of_boundary |= {
        "network_boundary": jnp.mean(network),
        "network_boundary_spread": jnp.std(network),
    }
    metrics |= _where(hyper.learns_boundary > 0, of_boundary)
    risk = agent.risk_learner
    if risk is None or state.risk is None:
        return metrics
    risk = dataclasses.replace(risk, batch_size=SAMPLE)
    outcomes = risk.draw(memory, agent.layout, column, pool_key)
    _, of_risk = risk.improve(hyper, state.risk, *outcomes)
    return metrics | _where(hyper.has_arbiter > 0, of_risk)


def _where(known: chex.Array, metrics: Metrics) -> Metrics:
    """Metrics, or NaN where they mean nothing."""
    return {name: jnp.where(known, value, jnp.nan) for name, value in metrics.items()}


def on_host(metrics: Metrics, count: int) -> list[dict[str, float]]:
    """Metrics [K] of a device as Python's numbers, of the first `count` runs; waits for them."""
    fetched = jax.device_get(metrics)
    return [{name: float(value[k]) for name, value in fetched.items()} for k in range(count)]
