"""Replay of R runs in lockstep: one ring of frames, one cursor, each observation stored once.

A frame (`learner.frame`) is what happened at one tick of one run: the observation, and the step
taken from it. The next observation is the next frame's, so nothing is stored twice. When an episode
ends (terminated or truncated alike) the run spends one tick on the reset; that tick's frame is
`final`: it holds the true last observation, no step was taken from it and it is never drawn as the
start of a transition.

A frame is stored in two parts, `seen` (observation, action) and `outcome` (the others). An n-step
transition reads `seen` of two frames and `outcome` of n, and reading memory is what drawing costs.

Memory: capacity · R · width · 4 bytes, with width = O + A + 9. BipedalWalker has width 37: 200,000
frames of one run take 30 MB, of thirty runs 890 MB. The pool D of Algorithm 1 is the same ring read
through `sample_boundary`: it needs more of its columns than the task does.
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import chex
import jax
import jax.numpy as jnp
from flax import struct

from hitl_jax.learner.frame import CUT_OFF, Layout
from hitl_jax.types import BoundaryTransition, Transition

_OF_HUMAN = 2
"""What a key is folded with to seek the human's steps, so that the other draws stay as they are."""

TRIES = 16
"""Draws for each start that is sought among some of the frames."""

_DRAWS = 2
"""Draws for each start. Frames that are final are passed over; the chance that all draws are final
is (episodes / frames)^2, and then the step beside the final frame is taken."""


@struct.dataclass
class Replay:
    """The ring.

    Attributes:
        seen: observation and action of each frame, [R, T, O + A].
        outcome: the other columns of each frame, from `Layout.reward` on, [R, T, 9].
        cursor: frames written so far in each run's column, [].
        start: value of the cursor when the run in each column began, [R].
    """

    seen: chex.Array
    outcome: chex.Array
    cursor: chex.Array
    start: chex.Array


def init(capacity: int, num_runs: int, layout: Layout) -> Replay:
    """An empty ring of `capacity` frames for each of `num_runs` runs."""
    return Replay(
        seen=jnp.zeros((num_runs, capacity, layout.reward), jnp.float32),
        outcome=jnp.zeros((num_runs, capacity, layout.width - layout.reward), jnp.float32),
        cursor=jnp.zeros((), jnp.int32),
        start=jnp.zeros((num_runs,), jnp.int32),
    )


def add(replay: Replay, frames: chex.Array) -> Replay:
    """Writes U frames of every run at the cursor.

    Donate `replay` and the ring is changed in place.

    Args:
        replay: the ring.
        frames: [R, U, W]; U must divide the capacity, so that a write never wraps.

    Returns:
        The ring with its cursor U further.

    Raises:
        ValueError: at trace time, if U does not divide the capacity.
    """
    num_runs, capacity, split = replay.seen.shape
    count = frames.shape[1]
    chex.assert_shape(frames, (num_runs, count, split + replay.outcome.shape[2]))
    if capacity % count:
        raise ValueError(f"capacity {capacity} is no multiple of the {count} frames of one write")
    frames = jnp.asarray(frames, jnp.float32)
    at = (jnp.int32(0), replay.cursor % capacity, jnp.int32(0))
    return Replay(
        seen=jax.lax.dynamic_update_slice(replay.seen, frames[..., :split], at),
        outcome=jax.lax.dynamic_update_slice(replay.outcome, frames[..., split:], at),
        cursor=replay.cursor + count,
        start=replay.start,
    )


def begin_run(replay: Replay, column: chex.Array) -> Replay:
    """Hands a column to a new run: what stands in it is no longer drawn.

    Args:
        replay: the ring.
        column: index of the run's column, [].
    """
    return dataclasses.replace(replay, start=replay.start.at[column].set(replay.cursor))


def restore(replay: Replay, column: chex.Array, frames: chex.Array, start: chex.Array) -> Replay:
    """Fills a column with what stood in it.

    Args:
        replay: the ring.
        column: index of the run's column, [].
        frames: all of the column, [T, W].
        start: value of the cursor when the run began, [].
    """
    split = replay.seen.shape[2]
    return dataclasses.replace(
        replay,
        seen=replay.seen.at[column].set(frames[:, :split]),
        outcome=replay.outcome.at[column].set(frames[:, split:]),
        start=replay.start.at[column].set(start),
    )


def num_starts(replay: Replay, column: chex.Array, n_step: int) -> chex.Array:
    """How many frames of a column can start an n-step transition, final ones included, []."""
    oldest = jnp.maximum(replay.start[column], replay.cursor - replay.seen.shape[1])
    return jnp.maximum(replay.cursor - n_step - oldest, 0)


@struct.dataclass
class Draw:
    """Drawn n-step transitions: where their observations stand in the ring, and what lies between.

    Attributes:
        start: place of the first frame, int32 [...].
        after: place of the frame of the bootstrap, int32 [...].
        reward: R, [...].
        discount: of the bootstrap, [...].
    """

    start: chex.Array
    after: chex.Array
    reward: chex.Array
    discount: chex.Array


def draw(
    replay: Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    n_step: int,
    gamma: chex.Array,
    human_share: float = 0.0,
    num_batches: int = 1,
) -> Draw:
    """Draws n-step transitions of one run, uniformly with replacement.

    R = Σ_{i<m} γ^i r_{t+i}, where m is n or the number of steps left in the episode. The bootstrap
    is γ^m after m steps, 0 if the last of them terminated; a truncated step keeps it, with the true
    final observation.

    Args:
        replay: the ring; `num_starts` must be positive.
        layout: its columns.
        column: the run's column, [].
        key: consumed.
        batch_size: B, of all minibatches together: a multiple of their number.
        n_step: n.
        gamma: γ, [].
        human_share: static; of each minibatch, what is sought among the human's steps, 0 to 1,
            each by 16 draws.
        num_batches: static; how many minibatches are drawn, one after another.

    Returns:
        Draws, leaves [B].
    """
    capacity, gamma = replay.seen.shape[1], jnp.asarray(gamma, jnp.float32)
    begin = starts(replay, layout, column, key, batch_size, n_step)
    if human_share:
        sought = math.ceil(human_share * (batch_size // num_batches))
        human_key, size = jax.random.fold_in(key, _OF_HUMAN), num_batches * sought
        tries = starts(replay, layout, column, human_key, TRIES * size, n_step)
        is_wanted = functools.partial(is_human, replay, layout, column)
        found = sought_starts(tries, is_wanted, size)
        rows = begin.reshape(num_batches, -1)
        begin = rows.at[:, :sought].set(found.reshape(num_batches, sought)).reshape(-1)
    window = (begin[:, None] + jnp.arange(n_step, dtype=jnp.int32)) % capacity
    reward, terminated, truncated = (
        replay.outcome[column, window, index - layout.reward]
        for index in (layout.reward, layout.terminated, layout.truncated)
    )
    # alive[:, i]: the episode had not ended before step i of the window.
    alive = jnp.cumprod(1.0 - terminated - truncated, axis=1)
    alive = jnp.concatenate([jnp.ones((batch_size, 1), jnp.float32), alive[:, :-1]], axis=1)
    taken = jnp.sum(alive, axis=1).astype(jnp.int32)
    reward = jnp.where(alive > 0.0, reward, 0.0)
    return Draw(
        start=window[:, 0],
        after=(begin + taken) % capacity,
        reward=jnp.sum(alive * gamma ** jnp.arange(n_step, dtype=jnp.int32) * reward, axis=1),
        discount=gamma**taken * (1.0 - jnp.sum(alive * terminated, axis=1)),
    )


def read(replay: Replay, layout: Layout, column: chex.Array, drawn: Draw) -> Transition:
    """The minibatch that was drawn, leading axis B.

    Args:
        replay: the ring, as it was when they were drawn.
        layout: its columns.
        column: the run's column, [].
        drawn: leaves [B].
    """
    seen = replay.seen[column, drawn.start]
    return Transition(
        observation=seen[:, layout.observation],
        action=seen[:, layout.action],
        reward=drawn.reward,
        discount=drawn.discount,
        next_observation=replay.seen[column, drawn.after, layout.observation],
        human=is_human(replay, layout, column, drawn.start).astype(jnp.float32),
    )


def is_human(replay: Replay, layout: Layout, column: chex.Array, frames: chex.Array) -> chex.Array:
    """Whether the human took the step of a frame and the episode went on, bool [...]."""
    places = frames % replay.seen.shape[1]
    event, terminated, truncated = (
        replay.outcome[column, places, index - layout.reward]
        for index in (layout.event, layout.terminated, layout.truncated)
    )
    return (event == CUT_OFF) & (terminated + truncated == 0.0)


def sample_boundary(
    replay: Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    gamma: chex.Array,
) -> BoundaryTransition:
    """Draws samples (s_i, s_{i+1}, r_i, τ_i, τ_{i+1}) of the pool D (Algorithm 1, line 10).

    Args:
        replay: the ring; `num_starts` must be positive.
        layout: its columns.
        column: the run's column, [].
        key: consumed.
        batch_size: N.
        gamma: γ, [].

    Returns:
        A minibatch, leading axis N.
    """
    capacity = replay.seen.shape[1]
    begin = starts(replay, layout, column, key, batch_size, 1)
    seen = replay.seen[column, begin % capacity]
    after = replay.seen[column, (begin + 1) % capacity]
    outcome = replay.outcome[column, begin % capacity]

    def came(index: int) -> chex.Array:
        return outcome[:, index - layout.reward]

    return BoundaryTransition(
        observation=seen[:, layout.observation],
        boundary=came(layout.boundary),
        reward=came(layout.reward) + came(layout.boundary_reward),
        discount=gamma * (1.0 - came(layout.terminated)),
        next_observation=after[:, layout.observation],
        next_boundary=came(layout.next_boundary),
    )


def starts(
    replay: Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    n_step: int,
) -> chex.Array:
    """Numbers of frames that are steps with n frames behind them, int32 [B]."""
    count = num_starts(replay, column, n_step)
    oldest = replay.cursor - n_step - count
    draws = jax.random.randint(key, (_DRAWS, batch_size), 0, jnp.maximum(count, 1), jnp.int32)
    places = (oldest + draws) % replay.seen.shape[1]
    final = replay.outcome[column, places, layout.final - layout.reward] > 0.5
    chosen = jax.lax.argmin(final, 0, jnp.int32)
    begin = jnp.take_along_axis(draws, chosen[None], axis=0)[0]
    still_final = jnp.take_along_axis(final, chosen[None], axis=0)[0]
    beside = jnp.where(begin > 0, begin - 1, 1)  # The first frame of all has none before it.
    return oldest + jnp.where(still_final, beside, begin)


def sought_starts(
    starts: chex.Array, wanted: Callable[[chex.Array], chex.Array], batch_size: int
) -> chex.Array:
    """Of `TRIES` numbers of frames for each place the first that is wanted, else the first of all.

    Args:
        starts: of `starts`, [`TRIES` · B].
        wanted: maps numbers of frames to whether they are, bool [...].
        batch_size: B.

    Returns:
        int32 [B].
    """
    tries = starts.reshape(TRIES, batch_size)
    return jnp.take_along_axis(tries, jnp.argmax(wanted(tries), axis=0)[None], axis=0)[0]
