"""Trained parameters as flat, named arrays, and back: the `params.npz` of a finished run."""

import functools
import os
import pathlib
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.boundary.carry import first_carry
from hitl_jax.errors import InvalidValue
from hitl_jax.results.atomic_files import read_bytes
from hitl_jax.results.npz_archives import from_npz
from hitl_jax.team import agent as agents
from hitl_jax.team.agent import Agent
from hitl_jax.team.array_names import by_name, from_names
from hitl_jax.types import Params, TrainState


def flatten(train: TrainState, boundary: np.ndarray) -> dict[str, np.ndarray]:
    """The networks of one run and the boundary source's carry, by flat name.

    Args:
        train: training state of one run; optimisers and targets are left out.
        boundary: the boundary source's carry, [] or [K].

    Returns:
        For example `actor/params/Dense_0/kernel`, and `boundary`.
    """
    flat = by_name(_networks(train))
    return {name: np.asarray(leaf) for name, leaf in flat.items()} | {
        "boundary": np.asarray(boundary)
    }


def _networks(train: TrainState) -> dict[str, Params]:
    networks = {
        "actor": train.learner.actor,
        "critic": train.learner.critic,
        "boundary_actor": train.boundary.actor,
        "boundary_critic": train.boundary.critic,
    }
    return networks if train.risk is None else networks | {"risk": train.risk.critic}


def networks_of(agent: Agent, arrays: Mapping[str, np.ndarray]) -> dict[str, Params]:
    """The inverse of `flatten`: parameters by network, and `boundary`.

    Args:
        agent: the team that was trained.
        arrays: by flat name.

    Raises:
        ValueError: one line, if they are another team's, or not finite.
    """
    like = _like(agent)
    expected = {name: leaf.shape for name, leaf in by_name(like).items()}
    for name in [*expected, *arrays]:
        if name not in arrays or name not in expected:
            has = "lacks" if name in expected else "holds"
            raise ValueError(f"{has} {name[:100]!r}: it has other networks than this team")
        shape, dtype = arrays[name].shape, arrays[name].dtype
        if shape != expected[name] or dtype != np.float32:
            network = name.partition("/")[0]
            raise ValueError(
                f"its {network} has other layers than this team's: {name} is {dtype} {shape}, must "
                f"be float32 {expected[name]}"
            )
        if not np.isfinite(arrays[name]).all():
            raise ValueError("not all its numbers are finite")
    networks: dict[str, Params] = from_names(like, dict(arrays))
    return networks


@functools.lru_cache(maxsize=4)
def _like(agent: Agent) -> dict[str, Params]:
    """The networks of a run of this team and `boundary`, as shapes."""
    train = jax.eval_shape(lambda: agents.init(agent, jax.random.key(0)))
    source = agent.boundary_source
    carry = jax.eval_shape(lambda: first_carry(source, jnp.zeros((), jnp.float32)))
    return _networks(train) | {"boundary": carry}


def load(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The arrays of a checkpoint by flat name.

    Raises:
        ValueError: in a few words, if it cannot be read.
    """
    try:
        return from_npz(read_bytes(pathlib.Path(path)))
    except ValueError as error:
        raise ValueError("is no checkpoint that can be read") from error


def load_actor(path: str | os.PathLike[str], observation_size: int, action_size: int) -> Params:
    """The task actor of a checkpoint, for use as the human's policy.

    Args:
        path: a `params.npz`.
        observation_size: O of the walker.
        action_size: A of the walker.

    Returns:
        Parameters of an `Actor`; `hidden_sizes` gives its widths.

    Raises:
        InvalidValue: one line, if the file is missing, no checkpoint, not finite, or of another
            walker.
    """
    try:
        layers = _layers(load(path))
        has = layers[0][0].shape[0], layers[-1][0].shape[1]
        if has != (observation_size, action_size):
            raise ValueError(
                f"has {has[0]} observations and {has[1]} actions, the walker has "
                f"{observation_size} and {action_size}"
            )
        if not all(np.isfinite(array).all() for layer in layers for array in layer):
            raise ValueError("its actor holds numbers that are not finite")
    except ValueError as error:
        raise InvalidValue("human_policy", path, str(error)) from error
    return {
        "params": {
            f"Dense_{place}": {"kernel": kernel, "bias": bias}
            for place, (kernel, bias) in enumerate(layers)
        }
    }


def _layers(arrays: Mapping[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Kernel [I, F] and bias [F] of each layer of a checkpoint's actor, as they follow.

    Raises:
        ValueError: in a few words, if there is none.
    """
    actor = {name: array for name, array in arrays.items() if name.startswith("actor/")}
    if not actor:
        raise ValueError("holds no actor; give a run's params.npz")
    layers: list[tuple[np.ndarray, np.ndarray]] = []
    while (name := f"actor/params/Dense_{len(layers)}") + "/kernel" in actor:
        layers.append((actor.pop(f"{name}/kernel"), actor.pop(f"{name}/bias", np.zeros(()))))
    widths = [kernel.shape[0] for kernel, _ in layers[1:] if kernel.ndim]
    fits = all(
        kernel.ndim == 2
        and kernel.size
        and kernel.dtype == bias.dtype == np.float32
        and bias.shape == kernel.shape[1:]
        for kernel, bias in layers
    )
    if not layers or actor or not fits or widths != [bias.size for _, bias in layers[:-1]]:
        raise ValueError("its actor is not one of this program")
    return layers


def hidden_sizes(actor: Params) -> tuple[int, ...]:
    """Widths of an actor's layers, the last being the number of actions."""
    layers = actor["params"]
    return tuple(layers[f"Dense_{index}"]["bias"].shape[0] for index in range(len(layers)))
