"""The human's judgement h_t of one run, put together from parts like an optax chain.

    danger ∘ reaction delay ∘ mistakes ∘ lapses ∘ limited attention

Each part is told what the parts before it judged and passes on its own judgement. A recorded log
(`recorded`) or a person at the keyboard is one more `HumanPart`.
"""

import functools
from collections.abc import Sequence

import chex
import jax.numpy as jnp

from hitl_jax.human.danger import DANGER_MODELS
from hitl_jax.human.params import MAX_DELAY, HumanParams
from hitl_jax.human.part import HumanPart, chain, unchanged, unmoved
from hitl_jax.human.parts import ATTENTION, DELAY, HUMAN_PARTS, LAPSES, MISTAKES, delayed

ALL_PARTS = (DELAY, MISTAKES, LAPSES, ATTENTION)
"""Parts that are applied to the danger model's judgement by default, in this order."""


def simulated_human(
    danger: str | HumanPart = "threshold",
    max_delay: int = MAX_DELAY,
    parts: Sequence[str | HumanPart] = ALL_PARTS,
) -> HumanPart:
    """Danger, then the parts in their order: by default delay ∘ mistakes ∘ lapses ∘ attention.

    Args:
        danger: a name in `DANGER_MODELS`, `module:name`, or a part of one's own.
        max_delay: longest delay [steps].
        parts: names in `HUMAN_PARTS`, `module:name`, or parts of one's own.

    Raises:
        InvalidValue: one line, for an unknown model or part.
        ValueError: one line, for a negative delay.
    """
    return _simulated(danger, max_delay, tuple(parts))


@functools.cache
def _simulated(
    danger: str | HumanPart, max_delay: int, parts: tuple[str | HumanPart, ...]
) -> HumanPart:
    # The same human for the same words: programs are compiled once for equal teams.
    made = [delayed(max_delay) if part == DELAY else HUMAN_PARTS.make(part) for part in parts]
    return chain(DANGER_MODELS.make(danger), *made)


def recorded(dangerous: chex.Array) -> HumanPart:
    """Plays back a log, one entry a step, over all episodes of a run; safe past its end.

    Args:
        dangerous: h_t = 0 of step t of the run, bool [T].

    Raises:
        ValueError: if the log is not of type bool and rank 1.
    """
    log = jnp.asarray(dangerous)
    if log.dtype != bool or log.ndim != 1:
        raise ValueError(f"log of judgements {log.dtype}{list(log.shape)}: must be bool[T]")
    num_steps = log.shape[0]
    log = jnp.append(log, False)

    def judge(
        state: chex.Array,
        params: HumanParams,
        observation: chex.Array,
        dangerous: chex.Array,
        key: chex.PRNGKey,
    ) -> tuple[chex.Array, chex.Array]:
        del params, observation, dangerous, key
        return jnp.minimum(state + 1, num_steps), log[state]

    return HumanPart(
        init=lambda: jnp.zeros((), jnp.int32),
        begin_episode=unchanged,
        judge=judge,
        notify=unmoved,
    )


def outcome_dangerous(fell: chex.Array, k: chex.Numeric) -> chex.Array:
    """Danger judged by outcome: the walker falls within k steps. For measuring only.

    State s_t is dangerous if one of the steps t, t + 1, ..., t + k − 1 ends in a fall.

    Args:
        fell: whether the step taken in s_t ended in a fall, bool [T], of one whole episode.
        k: steps to look ahead; 0 or less finds no danger.

    Returns:
        Whether s_t was dangerous, bool [T].
    """
    chex.assert_rank(fell, 1)
    falls_before = jnp.append(jnp.int32(0), jnp.cumsum(fell, dtype=jnp.int32))
    num_steps = fell.shape[0]
    start = jnp.arange(num_steps, dtype=jnp.int32)
    end = jnp.clip(start + k, start, num_steps)
    return falls_before[end] > falls_before[start]
