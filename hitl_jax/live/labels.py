"""Labels: which frames a person judged dangerous, and how line 8 is computed again from them.

A label names the frames that the person saw, and often comes some frames later. So the boundary
is computed again from the first of them. Alarms stay as they were raised.
"""

import dataclasses
from collections.abc import Sequence

import chex
import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax import boundary
from hitl_jax.config import RunHyper
from hitl_jax.team.acting import following


@dataclasses.dataclass
class Label:
    """What a person said about a stretch of frames.

    Attributes:
        number: counts the labels of a session.
        kind: `danger`, held or tapped; `safe`; `take`, control that the person took or that the
            arbiter gave; or `nobody`, where no person was there to judge.
        first: its first frame.
        last: its last frame; None while it goes on.
        cause: the number of the judgement for which the arbiter gave control; the two are taken
            back together. None for all that the person said.
    """

    number: int
    kind: str
    first: int
    last: int | None
    cause: int | None = None


def judged(labels: Sequence[Label], first: int, stop: int) -> np.ndarray:
    """Whether each frame of [first, stop) was judged dangerous, bool [stop - first].

    Where labels overlap, the last one counts.
    """
    return _last_is(labels, first, stop, ("danger", "take"))


def unjudged(labels: Sequence[Label], first: int, stop: int) -> np.ndarray:
    """Whether nobody was there to judge each frame of [first, stop), bool [stop - first]."""
    return _last_is(labels, first, stop, ("nobody",))


def _last_is(labels: Sequence[Label], first: int, stop: int, kinds: tuple[str, ...]) -> np.ndarray:
    """Whether the last label of each frame of [first, stop) is of these kinds."""
    found = np.zeros(max(stop - first, 0), bool)
    for label in labels:
        if label.last is None or label.last >= first:
            end = stop if label.last is None else label.last + 1
            found[max(label.first - first, 0) : max(end - first, 0)] = label.kind in kinds
    return found


def boundary_along(
    hyper: RunHyper,
    start: chex.Array,
    alarmed: chex.Array,
    dangerous: chex.Array,
    live: chex.Array,
) -> tuple[chex.Array, chex.Array, chex.Array]:
    """Computes line 8 of Algorithm 1 along K frames, for the boundary source `rule`.

    Args:
        hyper: the run's hyperparameters, scalars.
        start: τ at the first frame, [].
        alarmed: C of each frame as it was raised, bool [K].
        dangerous: h_t = 0, bool [K].
        live: whether a step was taken from the frame, bool [K].

    Returns:
        τ_t, τ_{t+1} and r'_t of each frame, [K] each. A frame without a step does not move the
        boundary.
    """

    def one(
        now: chex.Array, frame: tuple[chex.Array, chex.Array, chex.Array]
    ) -> tuple[chex.Array, tuple[chex.Array, chex.Array, chex.Array]]:
        alarm, danger, step = frame
        after = following(hyper, now, alarm, danger)
        reward = boundary.boundary_reward(alarm, danger, hyper.alarm_reward, hyper.human_price)
        return jnp.where(step, after, now), (now, after, reward)

    _, columns = jax.lax.scan(one, jnp.asarray(start, jnp.float32), (alarmed, dangerous, live))
    result: tuple[chex.Array, chex.Array, chex.Array] = columns
    return result
