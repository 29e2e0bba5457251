"""Hands that can walk: the actor of a trained walker, which comes with the package.

`trained_walker.md` beside it says how it was made.
"""

import functools
import io
from importlib import resources

import numpy as np

from hitl_jax.human.actions import ACTION_SOURCES, ActionSource, policy
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.learner.networks import Actor

FILE = "trained_walker.npz"
"""Arrays `actor/params/Dense_N/kernel` and `.../bias` of an `Actor`, float32."""


@ACTION_SOURCES.register("trained", "a trained walker, which comes with the package")
def _trained(action_size: int) -> ActionSource:
    del action_size
    return trained_walker()


@functools.cache
def trained_walker() -> ActionSource:
    """A walker for BipedalWalker-v3 that goes on where another has stumbled."""
    data = (resources.files("hitl_jax.human") / FILE).read_bytes()
    layers: dict[str, dict[str, np.ndarray]] = {}
    with np.load(io.BytesIO(data)) as arrays:
        for name in arrays:
            *_, layer, part = name.split("/")
            layers.setdefault(layer, {})[part] = arrays[name]
    *hidden, action_size = (len(layers[f"Dense_{index}"]["bias"]) for index in range(len(layers)))
    actor = Actor(tuple(hidden), action_size)
    return policy(actor.apply, {"params": layers})._replace(
        observation_size=WALKER_OBSERVATION, action_size=action_size
    )
