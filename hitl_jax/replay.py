"""Replay of R runs in lockstep: one ring of frames, one cursor, each observation stored once.

A frame is what happened at one tick of one run: the observation, and the step taken from it. The
next observation is the next frame's, so nothing is stored twice. When an episode ends (terminated
or truncated alike) the run spends one tick on the reset; that tick's frame is `final`: it holds the
true last observation, no step was taken from it and it is never drawn as the start of a transition.

Memory: capacity · R · width · 4 bytes, with width = O + A + 7. BipedalWalker has width 35: 200,000
frames of one run take 28 MB, of thirty runs 840 MB. The pool D of Algorithm 1 is the same ring read
through `sample_boundary`: it needs three of its columns more than the task does.
"""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
from flax import struct

from hitl_jax.types import BoundaryTransition, Transition

_DRAWS = 4
"""Draws for each start. Frames that are final are passed over; the chance that all draws are final
is (episodes / frames)^4, and then the step before the final frame is taken."""


class Layout(NamedTuple):
    """Columns of a packed frame, float32.

    Attributes:
        observation_size: O.
        action_size: A.
    """

    observation_size: int
    action_size: int

    @property
    def observation(self) -> slice:
        """s_t."""
        return slice(0, self.observation_size)

    @property
    def action(self) -> slice:
        """The executed action."""
        return slice(self.observation_size, self.observation_size + self.action_size)

    @property
    def reward(self) -> int:
        """r_t of equation (7)."""
        return self.observation_size + self.action_size

    @property
    def terminated(self) -> int:
        """1 where the step ended the episode and the bootstrap."""
        return self.reward + 1

    @property
    def truncated(self) -> int:
        """1 where the step ended the episode but not the bootstrap."""
        return self.reward + 2

    @property
    def final(self) -> int:
        """1 where no step was taken."""
        return self.reward + 3

    @property
    def boundary(self) -> int:
        """τ_t."""
        return self.reward + 4

    @property
    def next_boundary(self) -> int:
        """τ_{t+1} of line 8."""
        return self.reward + 5

    @property
    def boundary_reward(self) -> int:
        """r'_t."""
        return self.reward + 6

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.reward + 7


@struct.dataclass
class Replay:
    """The ring.

    Attributes:
        frames: packed frames, [R, T, W].
        cursor: frames written so far in each run's column, [].
        start: value of the cursor when the run in each column began, [R].
    """

    frames: chex.Array
    cursor: chex.Array
    start: chex.Array


def init(capacity: int, num_runs: int, layout: Layout) -> Replay:
    """An empty ring of `capacity` frames for each of `num_runs` runs."""
    return Replay(
        frames=jnp.zeros((num_runs, capacity, layout.width), jnp.float32),
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
    num_runs, capacity, width = replay.frames.shape
    count = frames.shape[1]
    chex.assert_shape(frames, (num_runs, count, width))
    if capacity % count:
        raise ValueError(f"capacity {capacity} is no multiple of the {count} frames of one write")
    at = (jnp.int32(0), replay.cursor % capacity, jnp.int32(0))
    written = jax.lax.dynamic_update_slice(replay.frames, frames, at)
    return Replay(frames=written, cursor=replay.cursor + count, start=replay.start)


def begin_run(replay: Replay, column: chex.Array) -> Replay:
    """Hands a column to a new run: what stands in it is no longer drawn.

    Args:
        replay: the ring.
        column: index of the run's column, [].
    """
    start = replay.start.at[column].set(replay.cursor)
    return Replay(frames=replay.frames, cursor=replay.cursor, start=start)


def num_starts(replay: Replay, column: chex.Array, n_step: int) -> chex.Array:
    """How many frames of a column can start an n-step transition, final ones included, []."""
    oldest = jnp.maximum(replay.start[column], replay.cursor - replay.frames.shape[1])
    return jnp.maximum(replay.cursor - n_step - oldest, 0)


def sample(
    replay: Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    n_step: int,
    gamma: chex.Array,
) -> Transition:
    """Draws n-step transitions of one run, uniformly with replacement.

    R = Σ_{i<m} γ^i r_{t+i}, where m is n or the number of steps left in the episode. The bootstrap
    is γ^m after m steps, 0 if the last of them terminated; a truncated step keeps it, with the true
    final observation.

    Args:
        replay: the ring; `num_starts` must be positive.
        layout: its columns.
        column: the run's column, [].
        key: consumed.
        batch_size: B.
        n_step: n.
        gamma: γ, [].

    Returns:
        A minibatch, leading axis B.
    """
    window = _windows(replay, layout, column, key, batch_size, n_step)
    ended = window[:, :n_step, layout.terminated] + window[:, :n_step, layout.truncated]
    # alive[:, i]: the episode had not ended before step i of the window.
    alive = jnp.cumprod(1.0 - ended, axis=1)
    alive = jnp.concatenate([jnp.ones((batch_size, 1)), alive[:, :-1]], axis=1)
    powers = gamma ** jnp.arange(n_step)
    reward = jnp.sum(alive * powers * window[:, :n_step, layout.reward], axis=1)
    taken = jnp.sum(alive, axis=1).astype(jnp.int32)
    terminated = jnp.sum(alive * window[:, :n_step, layout.terminated], axis=1)
    after = jnp.take_along_axis(window[:, :, layout.observation], taken[:, None, None], axis=1)
    return Transition(
        observation=window[:, 0, layout.observation],
        action=window[:, 0, layout.action],
        reward=reward,
        discount=gamma**taken * (1.0 - terminated),
        next_observation=after[:, 0],
    )


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
    window = _windows(replay, layout, column, key, batch_size, 1)
    now = window[:, 0]
    return BoundaryTransition(
        observation=now[:, layout.observation],
        boundary=now[:, layout.boundary],
        reward=now[:, layout.reward] + now[:, layout.boundary_reward],
        discount=gamma * (1.0 - now[:, layout.terminated]),
        next_observation=window[:, 1, layout.observation],
        next_boundary=now[:, layout.next_boundary],
    )


def _windows(
    replay: Replay,
    layout: Layout,
    column: chex.Array,
    key: chex.PRNGKey,
    batch_size: int,
    n_step: int,
) -> chex.Array:
    """Windows of n + 1 frames whose first is a step, [B, n + 1, W]."""
    capacity = replay.frames.shape[1]
    count = num_starts(replay, column, n_step)
    oldest = replay.cursor - n_step - count
    draws = jax.random.randint(key, (_DRAWS, batch_size), 0, jnp.maximum(count, 1))
    final = replay.frames[column, (oldest + draws) % capacity, layout.final] > 0.5
    chosen = jnp.argmin(final, axis=0)
    begin = jnp.take_along_axis(draws, chosen[None], axis=0)[0]
    begin = begin - jnp.take_along_axis(final, chosen[None], axis=0)[0]
    index = (oldest + jnp.maximum(begin, 0))[:, None] + jnp.arange(n_step + 1)
    return replay.frames[column, index % capacity]
