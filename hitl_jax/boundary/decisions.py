"""Samples of the pool D in which a takeover is one step: what a boundary decides, and what follows.

While a human has the controls, alarms change nothing. So a sample that begins an intervention lasts
until the machine acts again: its reward is what came in the meantime, and the bootstrap is from
there. A critic of single steps would believe that the machine goes on after one step of the human.
"""

import chex
import jax.numpy as jnp

from hitl_jax.learner import replay
from hitl_jax.learner.frame import CUT_OFF, Layout
from hitl_jax.types import BoundaryTransition

SPAN = 64
"""Longest takeover that is looked at; of a longer one the rest is as if the machine acted."""

_TRIES = 16


def sample_decisions(
    memory: replay.Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    gamma: chex.Array,
    alarmed: bool = False,
) -> BoundaryTransition:
    """Draws samples of one run.

    Args:
        memory: the ring.
        layout: its columns.
        column: the run's column, [].
        key: consumed.
        batch_size: N.
        gamma: γ, [].
        alarmed: static; whether steps in which r'_t is not 0 are sought: each is the first of 16
            draws that is one, or, if none is, any.

    Returns:
        A minibatch, leading axis N; steps in the middle of a takeover do not count.
    """
    capacity, gamma = memory.seen.shape[1], jnp.asarray(gamma, jnp.float32)
    begin = _begins(memory, layout, column, key, batch_size, alarmed)

    def came(places: chex.Array, index: int) -> chex.Array:
        return memory.outcome[column, places % capacity, index - layout.reward]

    window = begin[:, None] + jnp.arange(SPAN, dtype=jnp.int32)
    ended = came(window, layout.terminated) + came(window, layout.truncated)
    held = (came(window, layout.event) == CUT_OFF) & (ended == 0.0)
    before = (begin[:, None] - 1) % capacity
    goes_on = came(before, layout.terminated) + came(before, layout.truncated) == 0.0
    was_held = (came(before, layout.event) == CUT_OFF) & goes_on & (begin[:, None] > 0)
    acted = came(window, layout.event) == CUT_OFF
    # lasts[:, i]: the sample is still under way at step i, which the human takes as those before.
    lasts = jnp.cumprod(held[:, :-1] & acted[:, 1:], axis=1)
    lasts = jnp.concatenate([jnp.ones((batch_size, 1), jnp.int32), lasts], axis=1)
    taken = jnp.sum(lasts, axis=1)
    reward = jnp.where(lasts > 0, came(window, layout.reward), 0.0)
    powers = gamma ** jnp.arange(SPAN, dtype=jnp.int32)
    terminated = jnp.sum(lasts * came(window, layout.terminated), axis=1)
    seen = memory.seen[column, begin % capacity]
    after = memory.seen[column, (begin + taken) % capacity]
    enough = replay.num_starts(memory, column, SPAN) > 0
    return BoundaryTransition(
        observation=seen[:, layout.observation],
        boundary=came(begin, layout.boundary),
        reward=jnp.sum(powers * reward, axis=1) + came(begin, layout.boundary_reward),
        discount=gamma**taken * (1.0 - jnp.minimum(terminated, 1.0)),
        next_observation=after[:, layout.observation],
        next_boundary=came(begin, layout.next_boundary),
        counts=(enough & ~(was_held & acted[:, :1])[:, 0]).astype(jnp.float32),
    )


def _begins(
    memory: replay.Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    alarmed: bool,
) -> chex.Array:
    """Numbers of the frames that are drawn, int32 [N]."""
    if not alarmed:
        return replay.starts(memory, layout, column, key, batch_size, SPAN)
    begin = replay.starts(memory, layout, column, key, _TRIES * batch_size, SPAN)
    begin = begin.reshape(_TRIES, batch_size)
    places = begin % memory.seen.shape[1]
    found = memory.outcome[column, places, layout.boundary_reward - layout.reward] != 0.0
    return jnp.take_along_axis(begin, jnp.argmax(found, axis=0)[None], axis=0)[0]
