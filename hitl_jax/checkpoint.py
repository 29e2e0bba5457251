"""Trained parameters as flat, named arrays, and back: the `params.npz` of a finished run."""

import os
from collections.abc import Mapping

import jax
import numpy as np
from flax import traverse_util

from hitl_jax.types import Params, TrainState


def flatten(train: TrainState, boundary: np.ndarray) -> dict[str, np.ndarray]:
    """The networks of one run and the boundary source's carry, by flat name.

    Args:
        train: training state of one run; optimisers and targets are left out.
        boundary: the boundary source's carry, [] or [K].

    Returns:
        For example `actor/params/Dense_0/kernel`, and `boundary`.
    """
    networks = {
        "actor": train.learner.actor,
        "critic": train.learner.critic,
        "boundary_actor": train.boundary.actor,
        "boundary_critic": train.boundary.critic,
    }
    flat = traverse_util.flatten_dict(networks, sep="/")
    return {name: np.asarray(leaf) for name, leaf in flat.items()} | {
        "boundary": np.asarray(boundary)
    }


def unflatten(arrays: Mapping[str, np.ndarray]) -> dict[str, Params]:
    """The inverse of `flatten`: parameters by network, and `boundary`."""
    return traverse_util.unflatten_dict(dict(arrays), sep="/")


def load_actor(path: str | os.PathLike[str], observation_size: int, action_size: int) -> Params:
    """The task actor of a checkpoint, for use as the human's policy.

    Args:
        path: a `params.npz`.
        observation_size: O of the walker.
        action_size: A of the walker.

    Returns:
        Parameters of an `Actor`; `hidden_sizes` gives its widths.

    Raises:
        ValueError: one line, if the file is missing, no checkpoint, not finite, or of another
            walker.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            names = [name for name in archive.files if name.startswith("actor/")]
            actor = unflatten({name: archive[name] for name in names}).get("actor")
    except Exception as error:  # A flipped bit can make of zipfile's and NumPy's errors any.
        raise ValueError(f"--human-policy {path}: is no checkpoint that can be read") from error
    if actor is None:
        raise ValueError(f"--human-policy {path}: holds no actor; give a run's params.npz")
    try:
        has = actor["params"]["Dense_0"]["kernel"].shape[0], hidden_sizes(actor)[-1]
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"--human-policy {path}: its actor is not one of this program") from error
    if has != (observation_size, action_size):
        raise ValueError(
            f"--human-policy {path}: has {has[0]} observations and {has[1]} actions, "
            f"the walker has {observation_size} and {action_size}"
        )
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(actor)):
        raise ValueError(f"--human-policy {path}: its actor holds numbers that are not finite")
    return actor


def hidden_sizes(actor: Params) -> tuple[int, ...]:
    """Widths of an actor's layers, the last being the number of actions."""
    layers = actor["params"]
    return tuple(layers[f"Dense_{index}"]["bias"].shape[0] for index in range(len(layers)))
