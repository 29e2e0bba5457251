"""Samples of the pool D in which a takeover is one step: what a boundary decides, and what follows.

While a human has the controls, alarms change nothing. So a sample that begins an intervention lasts
until the machine acts again: its reward is what came in the meantime, and the bootstrap is from
there. A critic of single steps would believe that the machine goes on after one step of the human.
"""

import functools

import chex
import jax
import jax.numpy as jnp

from hitl_jax.learner import replay
from hitl_jax.learner.frame import CUT_OFF, Layout
from hitl_jax.types import BoundaryTransition

SPAN = 64
"""Longest takeover that is looked at; of a longer one the rest is as if the machine acted."""


def sample_decisions(
    memory: replay.Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    gamma: chex.Array,
    alarmed: bool = False,
    span: int = SPAN,
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
            draws that is one, or, if none is, any. With ρ = 0 none is ever found.
        span: static; longest takeover that is looked at. With 1 every step is a sample.

    Returns:
        A minibatch, leading axis N; steps in the middle of a takeover do not count, nor does the
        machine's first step after one, if it is cut off.
    """
    capacity, gamma = memory.seen.shape[1], jnp.asarray(gamma, jnp.float32)
    came = functools.partial(_came, memory, layout, column)
    begin = _begins(memory, layout, column, key, batch_size, alarmed)

    window = (begin[:, None] + jnp.arange(span, dtype=jnp.int32)) % capacity
    frames = memory.outcome[column, window]  # Once: to look up each number apart takes longer.

    def there(index: int) -> chex.Array:
        return frames[..., index - layout.reward]

    ended = there(layout.terminated) + there(layout.truncated)
    acted = there(layout.event) == CUT_OFF
    held = acted & (ended == 0.0)
    # lasts[:, i]: the sample is still under way at step i, which the human takes as those before.
    lasts = jnp.cumprod(held[:, :-1] & acted[:, 1:], axis=1)
    lasts = jnp.concatenate([jnp.ones((batch_size, 1), jnp.int32), lasts], axis=1)
    taken = jnp.sum(lasts, axis=1)
    reward = jnp.where(lasts > 0, there(layout.reward), 0.0)
    powers = gamma ** jnp.arange(span, dtype=jnp.int32)
    terminated = jnp.sum(lasts * there(layout.terminated), axis=1)
    seen = memory.seen[column, begin % capacity]
    after = memory.seen[column, (begin + taken) % capacity]
    enough = replay.num_starts(memory, column, SPAN) > 0
    counts = ~_in_takeover(memory, layout, column, begin) | (span == 1)
    batch = BoundaryTransition(
        observation=seen[:, layout.observation],
        boundary=came(begin, layout.boundary),
        reward=jnp.sum(powers * reward, axis=1) + came(begin, layout.boundary_reward),
        discount=gamma**taken * (1.0 - jnp.minimum(terminated, 1.0)),
        next_observation=after[:, layout.observation],
        next_boundary=came(begin, layout.next_boundary),
        counts=counts.astype(jnp.float32),
        boundary_reward=came(begin, layout.boundary_reward),
        explores=came(begin, layout.explores),
    )
    # Before that the ring has frames of another run, which must not matter.
    mine: BoundaryTransition = jax.tree.map(
        lambda leaf: jnp.where(enough, leaf, jnp.zeros_like(leaf)), batch
    )
    return mine


def _came(
    memory: replay.Replay, layout: Layout, column: chex.Array, frames: chex.Array, index: int
) -> chex.Array:
    """A number of frames of one run."""
    places = frames % memory.seen.shape[1]
    return memory.outcome[column, places, index - layout.reward]


def _in_takeover(
    memory: replay.Replay, layout: Layout, column: chex.Array, frames: chex.Array
) -> chex.Array:
    """Whether frames are steps in the middle of a takeover, bool [...]."""
    came = functools.partial(_came, memory, layout, column)
    oldest = jnp.maximum(memory.start[column], memory.cursor - memory.seen.shape[1])
    before = frames - 1
    goes_on = came(before, layout.terminated) + came(before, layout.truncated) == 0.0
    held_before = (came(before, layout.event) == CUT_OFF) & goes_on & (frames > oldest)
    return held_before & (came(frames, layout.event) == CUT_OFF)


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
    tries = replay.starts(memory, layout, column, key, replay.TRIES * batch_size, SPAN)

    def wanted(frames: chex.Array) -> chex.Array:
        alarms = _came(memory, layout, column, frames, layout.boundary_reward) != 0.0
        # In the middle of a takeover alarms change nothing.
        return alarms & ~_in_takeover(memory, layout, column, frames)

    return replay.sought_starts(tries, wanted, batch_size)
