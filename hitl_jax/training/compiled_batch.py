"""The one place where runs are vmapped: R runs that share nothing but the ring's cursor.

Learning. On a CPU device, a loop takes the runs that are to learn one by one, and makes all updates
of a call on one before the next (`devices.default_tile` says why). An accelerator takes them in
tiles (`vmap` within a tile); one that is not full is filled up with copies of its first run. Which
runs learn, and how many, are arguments: a run that has finished or is still warming up costs
nothing, and nothing is compiled again. Each device has its own runs and the same programs: two CPU
devices keep two cores busy better than one with two threads, since a small matrix product does not
split well.

Acting. One small program for all runs on one device, called once a tick by the host loop, or a part
of a program for a whole chunk (`hitl_jax.training.host_stage` has both). It has rows for A ≥ R runs
(`hitl_jax.xla.full_registers`); those behind the last run mean nothing.

Training states, what acting remembers, and hyperparameters are packed, a row of words for each run:
each array of a call costs the host time, and each that a run takes and gives costs a kernel.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import SingleDeviceSharding

from hitl_jax.choices.checks import MOST_SEED, require_whole
from hitl_jax.config import RunHyper, typed
from hitl_jax.learner import replay
from hitl_jax.team import agent as agents
from hitl_jax.team.acting import ActingState, init_acting
from hitl_jax.team.agent import Agent
from hitl_jax.team.packed_decision import act_or_begin
from hitl_jax.types import Behavior, TrainState
from hitl_jax.xla import full_registers
from hitl_jax.xla.pytree_words import from_pieces, pack, piece_sizes, to_pieces, unpack
from hitl_jax.xla.threefry import make_key

_SOME_HYPER = typed(RunHyper())
"""Hyperparameters of the types that every run's have."""


class Seats(NamedTuple):
    """Everything on a learning device.

    Attributes:
        train: training states, packed, uint32 [R, P].
        hyper: hyperparameters, packed, uint32 [R, H].
        memory: the replay.
    """

    train: chex.Array
    hyper: chex.Array
    memory: replay.Replay


class Packed(NamedTuple):
    """What acting needs of R runs' parameters, as they lie on the learning devices.

    Attributes:
        rows: packed, [R, B].
        finite: whether all of a row is finite, bool [R].
    """

    rows: chex.Array
    finite: chex.Array


class Acting(NamedTuple):
    """Everything on an acting device, packed.

    Attributes:
        state: acting states, uint32 [A, S].
        hyper: hyperparameters, uint32 [A, H].
    """

    state: chex.Array
    hyper: chex.Array


class Programs(NamedTuple):
    """The compiled programs of one batch of runs.

    Attributes:
        begin: key to the training state of a fresh run, as words [P], and what acting needs of it,
            packed [B]; one program for all devices, since it takes long to compile.
        seat: (seats, slot, hyper, training state as words [P]) to seats with a fresh run in `slot`;
            donates.
        seat_acting: (acting, slot, hyper, key) to acting with a fresh run in `slot`; donates.
        act: (acting, behavior, observation [A, O], live bool [A]) to (acting, packed [A, W + 6]);
            donates.
        learn: (seats, frames [R, U, W], slots int32 [R], count int32 []) to seats and `Packed`, a
            copy of what acting needs of them; donates. The first `count` of `slots` learn.
        pack_behavior: training states as words [R, P] to `Packed`.
        seat_behavior: (`Packed`, slot, row [B]) to `Packed`, for a fresh run in `slot`; donates.
        unpack_behavior: (rows of `Packed` of each device, and, where they are in the host's memory,
            any array of the device on which it shall happen) to what acting needs of all runs, one
            device after the other, leaves [A, ...].
        boundaries: acting to the carry of each run's boundary source, [A] or [A, K].
        unpack_train: (training states as words [R, P], slot) to that of the run in `slot`.
        restore: (seats, slot, training state as words [P], the run's column of the ring [T, W],
            value of the cursor when the run began) to seats with that run in `slot`; donates.
        restore_acting: (acting, slot, acting state as words [S]) to acting; donates.
        begin_ring: (seats, value) to seats whose rings have their cursor there; donates.
    """

    begin: Callable[[chex.PRNGKey], tuple[chex.Array, chex.Array]]
    seat: Callable[..., Seats]
    seat_acting: Callable[..., Acting]
    act: Callable[..., tuple[Acting, chex.Array]]
    learn: Callable[..., tuple[Seats, Packed]]
    pack_behavior: Callable[[chex.Array], Packed]
    seat_behavior: Callable[..., Packed]
    unpack_behavior: Callable[..., Behavior]
    boundaries: Callable[[Acting], chex.Array]
    unpack_train: Callable[..., TrainState]
    restore: Callable[..., Seats]
    restore_acting: Callable[..., Acting]
    begin_ring: Callable[..., Seats]


def run_keys(seed: int, method_index: int) -> tuple[chex.PRNGKey, chex.PRNGKey, chex.PRNGKey]:
    """Keys for learning, acting and testing of a run: from its method and seed alone.

    Args:
        seed: in [0, 2³²).
        method_index: see `hitl_jax.training.run_spec.method_index`.

    Raises:
        ValueError: one line, for a number out of range.
    """
    require_whole("seed", seed, at_most=MOST_SEED)
    require_whole("method_index", method_index)
    # As one program: operation by operation, the keys of a thousand runs take half a minute.
    return _run_keys(np.uint32(seed), np.uint32(method_index))


@jax.jit
def _run_keys(
    seed: chex.Array, method_index: chex.Array
) -> tuple[chex.PRNGKey, chex.PRNGKey, chex.PRNGKey]:
    key = jax.random.fold_in(make_key(seed), method_index)
    learning, acting, testing = jax.random.split(key, 3)
    return learning, acting, testing


def empty_seats(agent: Agent, num_runs: int, capacity: int, device: jax.Device) -> Seats:
    """Seats without runs, placed on one device.

    Args:
        agent: the team.
        num_runs: R, of this device.
        capacity: T, frames in the ring of each run.
        device: where their runs will learn.
    """

    def make() -> Seats:
        some = jax.eval_shape(pack, _some_train(agent))
        return Seats(
            train=jnp.zeros((num_runs, *some.shape), some.dtype),
            hyper=_rows(pack(_SOME_HYPER), num_runs),
            memory=replay.init(capacity, num_runs, agent.layout),
        )

    return jax.jit(make, out_shardings=SingleDeviceSharding(device))()


def empty_acting(agent: Agent, num_runs: int, device: jax.Device) -> Acting:
    """Acting without runs, placed on one device.

    Args:
        agent: the team.
        num_runs: R.
        device: where acting happens.
    """

    def make() -> Acting:
        return Acting(
            state=_rows(pack(_some_acting(agent)), full_registers.full(num_runs)),
            hyper=_rows(pack(_SOME_HYPER), full_registers.full(num_runs)),
        )

    return jax.jit(make, out_shardings=SingleDeviceSharding(device))()


@functools.lru_cache(maxsize=8)
def make_programs(agent: Agent, num_updates: int, tile: int) -> Programs:
    """Compiles lazily: each program at its first call on a device, and once for equal arguments.

    Args:
        agent: the team; its parts must be hashable, as functions are.
        num_updates: updates of the task learner in one call of `learn`.
        tile: runs that are vmapped together, see `devices.default_tile`; 1 takes them one by one.
    """

    def begin(key: chex.PRNGKey) -> tuple[chex.Array, chex.Array]:
        words = pack(agents.init(agent, key))
        return words, _pack_behavior(agent, words[None]).rows[0]

    def seat(seats: Seats, slot: chex.Array, hyper: RunHyper, words: chex.Array) -> Seats:
        return Seats(
            train=seats.train.at[slot].set(words),
            hyper=seats.hyper.at[slot].set(pack(hyper)),
            memory=replay.begin_run(seats.memory, slot),
        )

    def seat_acting(acting: Acting, slot: chex.Array, hyper: RunHyper, key: chex.PRNGKey) -> Acting:
        return Acting(
            state=acting.state.at[slot].set(pack(init_acting(agent, hyper, key))),
            hyper=acting.hyper.at[slot].set(pack(hyper)),
        )

    # Hyperparameters go in and do not come out.
    act_all = jax.jit(jax.vmap(functools.partial(act_packed, agent)), donate_argnums=0)
    learn_all = jax.jit(functools.partial(_learn_all, agent, num_updates, tile), donate_argnums=0)

    def act(
        acting: Acting, params: Behavior, observation: chex.Array, live: chex.Array
    ) -> tuple[Acting, chex.Array]:
        state, packed = act_all(acting.state, acting.hyper, params, observation, live)
        return acting._replace(state=state), packed

    def learn(
        seats: Seats, frames: chex.Array, slots: chex.Array, count: chex.Array
    ) -> tuple[Seats, Packed]:
        (train, memory), packed = learn_all(
            (seats.train, seats.memory), seats.hyper, frames, slots, count
        )
        return seats._replace(train=train, memory=memory), packed

    def boundaries(acting: Acting) -> chex.Array:
        like = _some_acting(agent)
        return jax.vmap(lambda state: unpack(like, state).boundary)(acting.state)

    def restore(
        seats: Seats, slot: chex.Array, words: chex.Array, ring: chex.Array, start: chex.Array
    ) -> Seats:
        return seats._replace(
            train=seats.train.at[slot].set(words),
            memory=replay.restore(seats.memory, slot, ring, start),
        )

    def begin_ring(seats: Seats, cursor: chex.Array) -> Seats:
        memory = dataclasses.replace(seats.memory, cursor=jnp.asarray(cursor, jnp.int32))
        return seats._replace(memory=memory)

    def restore_acting(acting: Acting, slot: chex.Array, words: chex.Array) -> Acting:
        return acting._replace(state=acting.state.at[slot].set(words))

    def seat_behavior(packed: Packed, slot: chex.Array, row: chex.Array) -> Packed:
        return Packed(
            rows=packed.rows.at[slot].set(row),
            finite=packed.finite.at[slot].set(jnp.isfinite(row).all()),
        )

    return Programs(
        begin=jax.jit(begin),
        seat=jax.jit(seat, donate_argnums=0),
        seat_acting=jax.jit(seat_acting, donate_argnums=0),
        act=act,
        learn=learn,
        pack_behavior=jax.jit(functools.partial(_pack_behavior, agent)),
        seat_behavior=jax.jit(seat_behavior, donate_argnums=0),
        unpack_behavior=jax.jit(functools.partial(_unpack_behavior, agent), keep_unused=True),
        boundaries=jax.jit(boundaries),
        unpack_train=jax.jit(lambda words, slot: unpack(_some_train(agent), words[slot])),
        restore=jax.jit(restore, donate_argnums=0),
        restore_acting=jax.jit(restore_acting, donate_argnums=0),
        begin_ring=jax.jit(begin_ring, donate_argnums=0),
    )


def act_packed(
    agent: Agent,
    state: chex.Array,
    hyper: chex.Array,
    params: Behavior,
    observation: chex.Array,
    live: chex.Array,
) -> tuple[chex.Array, chex.Array]:
    """`act_or_begin` of one run with acting state, [S], and hyperparameters, [H], packed."""
    before, settings = unpack(_some_acting(agent), state), unpack(_SOME_HYPER, hyper)
    after, packed = act_or_begin(agent, settings, params, before, observation, live)
    return pack(after), packed


def _some_acting(agent: Agent) -> ActingState:
    """An acting state of the types and shapes that every run's has."""
    return init_acting(agent, _SOME_HYPER, make_key(0))


def _some_train(agent: Agent) -> TrainState:
    """Types and shapes of every run's training state."""
    like: TrainState = jax.eval_shape(lambda: agents.init(agent, make_key(0)))
    return like


def flat(behavior: Behavior) -> np.ndarray:
    """One run's row of what `Programs.unpack_behavior` takes, [B]."""
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(behavior)])


def _pack_behavior(agent: Agent, train: chex.Array) -> Packed:
    """What acting needs of training states [R, P]."""
    behavior = agents.behavior(jax.vmap(functools.partial(unpack, _some_train(agent)))(train))
    leaves = jax.tree.leaves(behavior)
    rows = jnp.concatenate([leaf.reshape(leaf.shape[0], -1) for leaf in leaves], axis=1)
    return Packed(rows, jnp.isfinite(rows).all(axis=1))


def _unpack_behavior(
    agent: Agent, packed: Sequence[chex.Array], beside: chex.Array | None = None
) -> Behavior:
    """What acting needs of runs, leaves [A, ...], from arrays of some of them, [.., B]."""
    del beside  # It has told the device.
    num_runs = sum(map(len, packed))
    behind = jnp.zeros(
        (full_registers.full(num_runs) - num_runs, packed[0].shape[1]), packed[0].dtype
    )
    leaves, structure = jax.tree.flatten(agents.behavior(_some_train(agent)))
    ends = np.cumsum([leaf.size for leaf in leaves])
    # Split before they are joined: all is copied once.
    parts = zip(*(jnp.split(rows, ends[:-1], axis=1) for rows in (*packed, behind)), strict=True)
    return jax.tree.unflatten(
        structure,
        [
            jnp.concatenate(part).reshape(-1, *leaf.shape)
            for part, leaf in zip(parts, leaves, strict=True)
        ],
    )


def _learn_all(
    agent: Agent,
    num_updates: int,
    tile: int,
    before: tuple[chex.Array, replay.Replay],
    hyper: chex.Array,
    frames: chex.Array,
    slots: chex.Array,
    count: chex.Array,
) -> tuple[tuple[chex.Array, replay.Replay], Packed]:
    """`Programs.learn` of training states [R, P] and the replay, hyperparameters [R, H] apart."""
    train, memory = before
    memory = replay.add(memory, frames)
    like = _some_train(agent)

    def learn(words: chex.Array, state: TrainState, column: chex.Array) -> TrainState:
        settings = unpack(_SOME_HYPER, words)
        return agents.learn(agent, settings, state, memory, column, num_updates)

    def learn_one(index: chex.Array, train: chex.Array) -> chex.Array:
        slot = slots[index]
        return _give(train, slot, learn(hyper[slot], _take(like, train, slot), slot))

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
    return (train, memory), _pack_behavior(agent, train)


def _take(like: chex.ArrayTree, words: chex.Array, slot: chex.Array) -> chex.ArrayTree:
    """One row of words [R, P], unpacked, each piece read by itself: all is copied once."""
    pieces, place = [], 0
    for size in piece_sizes(like):
        pieces.append(jax.lax.dynamic_slice(words, (slot, jnp.int32(place)), (1, size))[0])
        place += size
    return from_pieces(like, pieces)


def _give(words: chex.Array, slot: chex.Array, tree: chex.ArrayTree) -> chex.Array:
    """The words with one row replaced, in place within a loop.

    XLA copies all words first unless what is written first depends on all that was read: among
    the small leaves, the first piece, are the optimiser's counts, which the loop of updates gives.
    """
    place = 0
    for piece in to_pieces(tree):
        words = jax.lax.dynamic_update_slice(words, piece[None], (slot, jnp.int32(place)))
        place += piece.size
    return words


def _rows(words: chex.Array, num_runs: int) -> chex.Array:
    """R copies of one run's row."""
    return jnp.broadcast_to(words, (num_runs, *words.shape))
