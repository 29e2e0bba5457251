"""The walker on JAX's accelerator beside the same walker on the CPU."""

import functools
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import walker
from hitl_jax.human.actions import scripted_walker
from hitl_jax.results.episode_measures import Row
from hitl_jax.walker import Walker
from hitl_jax.xla.threefry import make_key

STEPS = (10, 50)
CLOSE = 1e-6
CLOSE_BAR = 0.95
_WALKERS = 256
_FIRST = 100
"""The step from which several steps are compared: on hardcore terrain walkers have come to the
first obstacles."""
_NOISE = 0.3
"""Standard deviation of the noise on the actions of the last walker; the first has none."""
_HELD = 8
"""Steps for which the noise stays as it is."""

_source = scripted_walker()


@functools.partial(jax.jit, static_argnums=1)
def _begin(seeds: jax.Array, hardcore: bool) -> Walker:
    return jax.vmap(lambda seed: walker.new_walker(make_key(seed), hardcore))(seeds)


_step = jax.jit(jax.vmap(walker.step))


@jax.jit
def _script(states: Any, observations: jax.Array) -> tuple[Any, jax.Array]:
    """The next actions of scripted walkers."""
    return jax.vmap(lambda state, seen: _source.act(state, seen, make_key(0)))(states, observations)


def _fresh(count: int) -> Any:
    """States of so many scripted walkers at the start of an episode."""
    return jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * count), _source.init())


def measure_accelerator(seed: int, hardcore: bool) -> list[Row]:
    """Errors of the observation after one step, and several, from states of the CPU's walkers.

    They are gymnasium's scripted walkers, with noise, and count until they fall.

    Args:
        seed: of terrains and actions.
        hardcore: whether the terrain has stumps, stairs and pits.

    Returns:
        A row for one step, and one for each of `STEPS`.
    """
    device = jax.devices()[0]
    rng = np.random.default_rng(seed)
    seeds = rng.integers(2**32, size=_WALKERS, dtype=np.uint32)
    shape = (1 + (_FIRST + STEPS[-1]) // _HELD, _WALKERS, walker.ACTION_SIZE)
    scale = np.linspace(0, _NOISE, _WALKERS)[:, None]
    noise = (scale * rng.standard_normal(shape)).astype(np.float32)
    single: list[np.ndarray] = []
    rows: list[Row] = []
    ahead: Walker | None = None
    for count, (before, action, seen, alive) in enumerate(_played(seeds, noise, hardcore)):
        given = jax.device_put(before, device)
        single.append(_errors(_step(given, action)[1], seen, alive))
        if count < _FIRST:
            continue
        ahead, step = _step(given if ahead is None else ahead, action)
        if (steps := count + 1 - _FIRST) in STEPS:
            error = _errors(step, seen, alive)
            rows.append(_row(f"{steps} steps from step {_FIRST}", error))
    one = _row("one step", np.concatenate(single)) | {"bar": CLOSE_BAR}
    return [one, *rows]


def _played(
    seeds: np.ndarray, noise: np.ndarray, hardcore: bool
) -> Iterator[tuple[Walker, np.ndarray, np.ndarray, np.ndarray]]:
    """Steps on the CPU: walkers before, actions, observations after, and who stands until then."""
    # Not around `yield`: what the caller does in between is not for the CPU.
    on_cpu = functools.partial(jax.default_device, jax.devices("cpu")[0])
    with on_cpu():
        walkers, states = _begin(jnp.asarray(seeds), hardcore), _fresh(len(seeds))
        observation = jnp.zeros((len(seeds), walker.OBSERVATION_SIZE))
    alive = np.ones(len(seeds), bool)
    for count in range(_FIRST + STEPS[-1]):
        before = walkers
        with on_cpu():
            states, script = _script(states, observation)
            action = np.clip(np.asarray(script) + noise[count // _HELD], -1, 1)
            action *= count > 0  # The step that ends a reset has none.
            walkers, step = _step(before, action)
        observation = step.observation
        alive = alive & ~np.asarray(step.terminated)
        yield before, action, np.asarray(observation), alive


def _errors(step: walker.Step, seen: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Of the observations of those who stand, [.., 24]."""
    return np.abs(np.asarray(step.observation) - seen)[alive]


def _row(name: str, error: np.ndarray) -> Row:
    """Errors of observations, [.., 24]."""
    values = np.quantile(error, [0.5, 0.95, 0.99, 1.0])
    told = {
        label: float(f"{value:.1e}")
        for label, value in zip(("median error", "95 %", "99 %", "most"), values, strict=True)
    }
    return {
        "steps": name,
        "walkers": len(error),
        **told,
        f"share within {CLOSE:g}": round(float((error <= CLOSE).mean()), 4),
    }
