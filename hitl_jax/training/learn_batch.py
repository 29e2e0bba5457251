"""One call of the learner: updates of the runs of one device, one by one or in tiles.

On a CPU device, a loop takes the runs that are to learn one by one, and makes all updates of a call
on one before the next (`devices.default_tile` says why). An accelerator takes them in tiles (`vmap`
within a tile); one that is not full is filled up with copies of its first run. Which runs learn,
and how many, are arguments: a run that has finished or is still warming up costs nothing, and
nothing is compiled again.
"""

import functools

import chex
import jax
import jax.numpy as jnp

from hitl_jax.learner import replay
from hitl_jax.team import agent as agents
from hitl_jax.team.agent import Agent
from hitl_jax.training.batch_arrays import PackedBehavior, pack_behavior, some_hyper, some_train
from hitl_jax.types import TrainState
from hitl_jax.xla.pytree_words import from_pieces, pack, piece_sizes, to_pieces, unpack


def learn_all(
    agent: Agent,
    num_updates: int,
    tile: int,
    before: tuple[chex.Array, replay.Replay],
    hyper: chex.Array,
    frames: chex.Array,
    slots: chex.Array,
    count: chex.Array,
) -> tuple[tuple[chex.Array, replay.Replay], PackedBehavior]:
    """`Programs.learn` of training states [R, P] and the replay, hyperparameters [R, H] apart."""
    train, memory = before
    memory = replay.add(memory, frames)
    like = some_train(agent)

    def learn(words: chex.Array, state: TrainState, column: chex.Array) -> TrainState:
        settings = unpack(some_hyper(agent), words)
        return agents.learn(agent, settings, state, memory, column, num_updates)

    def learn_one(index: chex.Array, train: chex.Array) -> chex.Array:
        slot = slots[index]
        return _write_row(train, slot, learn(hyper[slot], _unpack_row(like, train, slot), slot))

    padded = jnp.concatenate([slots, jnp.zeros((tile,), slots.dtype)])

    def learn_tile(index: chex.Array, train: chex.Array) -> chex.Array:
        chosen = jax.lax.dynamic_slice_in_dim(padded, index * tile, tile)
        filled = index * tile + jnp.arange(tile, dtype=jnp.int32) < count
        chosen = jnp.where(filled, chosen, chosen[0])
        states = jax.vmap(functools.partial(unpack, like))(train[chosen])
        after = jax.vmap(learn)(hyper[chosen], states, chosen)
        return train.at[chosen].set(jax.vmap(pack)(after))

    if tile == 1:  # Without an axis of runs: XLA's sums are slow beside one of length 1.
        train = jax.lax.fori_loop(0, count, learn_one, train)
    else:
        train = jax.lax.fori_loop(0, (count + tile - 1) // tile, learn_tile, train)
    return (train, memory), pack_behavior(agent, train)


def _unpack_row(like: chex.ArrayTree, words: chex.Array, slot: chex.Array) -> chex.ArrayTree:
    """One row of words [R, P], unpacked, each piece read by itself: all is copied once."""
    pieces, place = [], 0
    for size in piece_sizes(like):
        pieces.append(jax.lax.dynamic_slice(words, (slot, jnp.int32(place)), (1, size))[0])
        place += size
    return from_pieces(like, pieces)


def _write_row(words: chex.Array, slot: chex.Array, tree: chex.ArrayTree) -> chex.Array:
    """The words with one row replaced, in place within a loop.

    XLA copies all words first unless what is written first depends on all that was read: among
    the small leaves, the first piece, are the optimiser's counts, which the loop of updates gives.
    """
    place = 0
    for piece in to_pieces(tree):
        words = jax.lax.dynamic_update_slice(words, piece[None], (slot, jnp.int32(place)))
        place += piece.size
    return words
