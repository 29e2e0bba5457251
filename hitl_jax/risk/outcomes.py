"""Samples of the replay for the risk critic: states, and what followed them."""

import chex
import jax
import jax.numpy as jnp

from hitl_jax.learner import replay
from hitl_jax.learner.frame import CUT_OFF, FALL, Layout
from hitl_jax.types import Outcome


def sample_outcomes(
    memory: replay.Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    horizon: int,
    newest: chex.Array | int = 0,
    count: chex.Array | int | None = None,
) -> Outcome:
    """Draws states of one run, uniformly, with what followed them within a horizon.

    Args:
        memory: the ring.
        layout: its columns.
        column: the run's column, [].
        key: consumed.
        batch_size: B.
        horizon: H, steps.
        newest: frames before the last H that are passed over, [].
        count: frames before those from which is drawn, []; None is all.

    Returns:
        A minibatch, leading axis B. Frames from which the machine took no step do not count, and
        none does where there is none to draw.
    """
    capacity = memory.seen.shape[1]
    behind = jnp.maximum(replay.num_starts(memory, column, horizon) - newest, 0)
    count = behind if count is None else jnp.minimum(behind, count)
    first = memory.cursor - horizon - newest - count
    begin = first + jax.random.randint(key, (batch_size,), 0, jnp.maximum(count, 1), jnp.int32)
    window = (begin[:, None] + jnp.arange(horizon, dtype=jnp.int32)) % capacity
    events = memory.outcome[column, window, layout.event - layout.reward]
    steps = jnp.argmax(events > 0.0, axis=1)  # 0 where nothing happened, as `event` then says.
    event = jnp.take_along_axis(events, steps[:, None], axis=1)[:, 0]
    cut_off = event == CUT_OFF
    final = memory.outcome[column, window[:, 0], layout.final - layout.reward] > 0.5
    return Outcome(
        observation=memory.seen[column, window[:, 0], layout.observation],
        fell=(event == FALL).astype(jnp.float32),
        cut_off=cut_off.astype(jnp.float32),
        last_observation=memory.seen[column, (begin + steps) % capacity, layout.observation],
        explores=memory.outcome[column, window[:, 0], layout.explores - layout.reward],
        counts=((count > 0) & ~final & ~(cut_off & (steps == 0))).astype(jnp.float32),
    )
