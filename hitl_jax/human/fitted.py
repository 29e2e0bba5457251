"""A human who was fitted to what a person did: judges from what the walker does, and acts.

The file is a small npz: a `RiskNetwork` that tells danger, the reaction delay, the probability from
which a state is dangerous, and, where the person acted enough, an `Actor`.
"""

from collections.abc import Mapping

import chex
import jax
import numpy as np

from hitl_jax.human.actions import ActionSource, policy
from hitl_jax.human.params import MAX_DELAY, HumanParams
from hitl_jax.human.part import HumanPart, chain, memoryless
from hitl_jax.human.parts import delayed
from hitl_jax.learner.networks import Actor, RiskNetwork
from hitl_jax.types import Params
from hitl_jax.xla.row_by_row import row_by_row

DANGER, HANDS = "network", "actor"
"""Prefixes of the networks' arrays."""
DELAY, LEAST = "delay", "least_expectation"
"""Reaction delay [steps], int32 []; probability from which a state is dangerous, float32 []."""
_MOST_LAYERS = 16

Arrays = Mapping[str, np.ndarray]


def judge_of(arrays: Arrays) -> HumanPart:
    """Danger is what the network holds for likely of the state of some steps ago.

    Args:
        arrays: of `require_fitted`.
    """
    layers, delay = _layers(arrays, DANGER), int(arrays[DELAY])
    *hidden, _ = (len(layer["bias"]) for layer in layers.values())
    logit = row_by_row(RiskNetwork(tuple(hidden)).apply)
    network: Params = {"params": layers}
    least = np.float32(arrays[LEAST])

    def rule(
        params: HumanParams, observation: chex.Array, dangerous: chex.Array, key: chex.PRNGKey
    ) -> chex.Array:
        del params, dangerous, key
        return jax.nn.sigmoid(logit(network, observation)) >= least

    size = layers["Dense_0"]["kernel"].shape[0]
    return chain(memoryless(rule, size), delayed(delay, own=delay))


def hands_of(arrays: Arrays) -> ActionSource | None:
    """What the person did with the controls; None where they hardly had them.

    Args:
        arrays: of `require_fitted`.
    """
    layers = _layers(arrays, HANDS)
    if not layers:
        return None
    *hidden, size = (len(layer["bias"]) for layer in layers.values())
    source = policy(Actor(tuple(hidden), size).apply, {"params": layers})
    return source._replace(observation_size=layers["Dense_0"]["kernel"].shape[0], action_size=size)


def require_fitted(arrays: Arrays) -> None:
    """Refuses arrays that are no fitted human.

    Raises:
        ValueError: in a few words.
    """
    shapes = {DELAY: np.dtype(np.int32), LEAST: np.dtype(np.float32)}
    for name, dtype in shapes.items():
        if name not in arrays or arrays[name].shape != () or arrays[name].dtype != dtype:
            raise ValueError(f"its {name} is no {dtype}")
    if not (0 <= arrays[DELAY] <= MAX_DELAY and 0.0 <= arrays[LEAST] <= 1.0):
        raise ValueError(f"delay and {LEAST} must be from 0 to {MAX_DELAY}, and from 0 to 1")
    known = set(shapes)
    for prefix in (DANGER, HANDS):
        layers = _layers(arrays, prefix)
        known |= {f"{prefix}/params/{layer}/{part}" for layer in layers for part in layers[layer]}
        _require_stacked(prefix, list(layers.values()))
    if unknown := set(arrays) - known:
        raise ValueError(f"holds {min(unknown)[:50]!r}")
    danger, hands = _layers(arrays, DANGER), _layers(arrays, HANDS)
    if not danger or danger[f"Dense_{len(danger) - 1}"]["bias"].shape != (1,):
        raise ValueError("has no network that tells danger")
    if hands and len(danger["Dense_0"]["kernel"]) != len(hands["Dense_0"]["kernel"]):
        raise ValueError("its networks see different observations")


def _require_stacked(prefix: str, layers: list[dict[str, np.ndarray]]) -> None:
    width = None
    for layer in layers:
        kernel, bias = layer.get("kernel"), layer.get("bias")
        fits = (
            kernel is not None
            and bias is not None
            and kernel.dtype == bias.dtype == np.float32
            and kernel.ndim == 2
            and min(kernel.shape) > 0
            and bias.shape == kernel.shape[1:]
            and width in (None, kernel.shape[0])
            and np.isfinite(kernel).all()
            and np.isfinite(bias).all()
        )
        if not fits:
            raise ValueError(f"its {prefix} is no stack of layers")
        assert kernel is not None
        width = kernel.shape[1]


def _layers(arrays: Arrays, prefix: str) -> dict[str, dict[str, np.ndarray]]:
    """Layers by name, from the first on; parts that are missing are left out."""
    layers: dict[str, dict[str, np.ndarray]] = {}
    for place in range(_MOST_LAYERS):
        head = f"{prefix}/params/Dense_{place}/"
        parts = {p: arrays[head + p] for p in ("kernel", "bias") if head + p in arrays}
        if not parts:
            break
        layers[f"Dense_{place}"] = parts
    return layers
