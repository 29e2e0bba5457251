"""Checks the spaces of gymnasium's environments, and scales actions from [-1, 1] onto them."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from hitl_jax.errors import Unplayable


def flat_size(env_id: str, name: str, space: Any) -> int:
    """Length of the vectors of a space.

    Args:
        env_id: name of the environment, for the message.
        name: `observation` or `action`.
        space: gymnasium's space.

    Raises:
        Unplayable: if its elements are not vectors of at least one number.
    """
    box = isinstance(space, gymnasium.spaces.Box)
    if not box or len(space.shape) != 1 or space.shape[0] < 1:
        raise Unplayable(env_id, f"{name}s must be flat vectors, not {space}")
    return int(space.shape[0])


def action_map(env_id: str, space: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Makes the function that scales a pool's actions onto an environment's bounds.

    With bounds of [-1, 1] actions stay as they are. With other bounds actions are clipped to
    [-1, 1] and scaled linearly: -1 and 1 become the bounds.

    Args:
        env_id: name of the environment, for the message.
        space: gymnasium's box of its actions [A].

    Returns:
        A function of actions float32 [..., A]. It returns a new array, which the environment may
        keep or change.

    Raises:
        Unplayable: if the actions are integers, or a bound is not finite.
    """
    if not np.issubdtype(space.dtype, np.floating):
        raise Unplayable(env_id, f"actions must be floats, not {space}")
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    if not np.isfinite([low, high]).all():
        raise Unplayable(
            env_id, f"actions must have finite bounds, onto which [-1, 1] is scaled, not {space}"
        )
    if (low == -1).all() and (high == 1).all():
        return np.copy
    middle, half = high / 2 + low / 2, high / 2 - low / 2

    def scaled(action: np.ndarray) -> np.ndarray:
        into = middle + half * np.clip(action, -1, 1)
        return into.astype(space.dtype).clip(space.low, space.high)

    return scaled
