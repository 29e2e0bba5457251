"""R independent runs as one batch; they share the write position of the replay, and nothing else.

Learning. Each device has its own runs and the same programs (`learn_batch`): two CPU devices keep
two cores busy better than one with two threads, since a small matrix product does not split well.

Acting. One small program for all runs on one device, called once a tick by the host loop
(`host_stage`), or a part of a program for a whole chunk (`device_stage`). It has rows for A ≥ R
runs (`xla.full_registers`); rows behind the last run are padding.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from hitl_jax.config import RunHyper
from hitl_jax.learner import replay
from hitl_jax.learner.losses import Metrics
from hitl_jax.team import agent as agents
from hitl_jax.team.acting import init_acting
from hitl_jax.team.agent import Agent
from hitl_jax.team.diagnostics import diagnose
from hitl_jax.team.packed_decision import act_or_begin
from hitl_jax.team.parts import as_tested
from hitl_jax.training.batch_arrays import (
    ActingBatch,
    LearnerBatch,
    PackedBehavior,
    pack_behavior,
    some_acting,
    some_hyper,
    some_train,
    unpack_behavior,
)
from hitl_jax.training.learn_batch import learn_all
from hitl_jax.types import Behavior
from hitl_jax.xla.pytree_words import pack, unpack


class Programs(NamedTuple):
    """The compiled programs of one batch of runs.

    Attributes:
        begin: key to the training state of a fresh run, as words [P], and what acting needs of it,
            packed [B]; one program for all devices, since it takes long to compile.
        begin_learning: (learner, slot, hyper, training state as words [P]) to the learner with a
            fresh run in `slot`; donates.
        begin_acting: (acting, slot, hyper, key) to acting with a fresh run in `slot`; donates.
        act: (acting, behavior, observation [A, O], live bool [A]) to (acting, packed [A, W + 6]);
            donates.
        learn: (learner, frames [R, U, W], slots int32 [R], count int32 []) to the learner and
            `PackedBehavior`, a copy of what acting needs; donates. The first `count` of `slots`
            learn.
        pack_behavior: training states as words [R, P] to `PackedBehavior`.
        put_behavior: (`PackedBehavior`, slot, row [B]) to the same with that row, for a fresh run
            in `slot`; donates.
        unpack_behavior: (rows of `PackedBehavior` of each device, and, where they are in the host's
            memory, any array of the device on which it shall happen) to what acting needs of all
            runs, one device after the other, leaves [A, ...].
        boundaries: acting to the carry of each run's boundary source, [A] or [A, K].
        row_of: (rows [R, ...], slot) to the row of the run in `slot`.
        tested_of: (training states as words [R, P], slot) to what a test needs of the run there, a
            row of `PackedBehavior`.
        diagnose: (learner, slots int32 [K]) to what `team.diagnostics` measures of the runs there,
            leaves [K].
        restore: (learner, slot, training state as words [P], the run's column of the ring [T, W],
            value of the cursor when the run began) to the learner with that run in `slot`; donates.
        restore_acting: (acting, slot, acting state as words [S]) to acting; donates.
        begin_ring: (learner, value) to a learner whose rings have their cursor there; donates.
    """

    begin: Callable[[chex.PRNGKey], tuple[chex.Array, chex.Array]]
    begin_learning: Callable[..., LearnerBatch]
    begin_acting: Callable[..., ActingBatch]
    act: Callable[..., tuple[ActingBatch, chex.Array]]
    learn: Callable[..., tuple[LearnerBatch, PackedBehavior]]
    pack_behavior: Callable[[chex.Array], PackedBehavior]
    put_behavior: Callable[..., PackedBehavior]
    unpack_behavior: Callable[..., Behavior]
    boundaries: Callable[[ActingBatch], chex.Array]
    row_of: Callable[..., chex.Array]
    tested_of: Callable[..., chex.Array]
    diagnose: Callable[[LearnerBatch, chex.Array], Metrics]
    restore: Callable[..., LearnerBatch]
    restore_acting: Callable[..., ActingBatch]
    begin_ring: Callable[..., LearnerBatch]


@functools.lru_cache(maxsize=8)
def make_programs(agent: Agent, num_updates: int, tile: int) -> Programs:
    """Compiles lazily: each program at its first call on a device, and once for equal arguments.

    Args:
        agent: the team; its parts must be hashable, as functions are.
        num_updates: updates of the task learner in one call of `learn`.
        tile: runs that are vmapped together, see `devices.default_tile`; 1 takes them one by one.
    """
    # Hyperparameters go in and do not come out.
    act_all = jax.jit(jax.vmap(functools.partial(act_packed, agent)), donate_argnums=0)
    learn = jax.jit(functools.partial(learn_all, agent, num_updates, tile), donate_argnums=0)
    return Programs(
        begin=jax.jit(functools.partial(_begin, agent)),
        begin_learning=jax.jit(_begin_learning, donate_argnums=0),
        begin_acting=jax.jit(functools.partial(_begin_acting, agent), donate_argnums=0),
        act=functools.partial(_act, act_all),
        learn=functools.partial(_learn, learn),
        pack_behavior=jax.jit(functools.partial(pack_behavior, agent)),
        put_behavior=jax.jit(_put_behavior, donate_argnums=0),
        unpack_behavior=jax.jit(functools.partial(unpack_behavior, agent), keep_unused=True),
        boundaries=jax.jit(functools.partial(_boundaries, agent)),
        row_of=jax.jit(lambda rows, slot: rows[slot]),
        tested_of=jax.jit(functools.partial(_tested_of, agent)),
        diagnose=jax.jit(functools.partial(_diagnose, agent)),
        restore=jax.jit(_restore, donate_argnums=0),
        restore_acting=jax.jit(_restore_acting, donate_argnums=0),
        begin_ring=jax.jit(_begin_ring, donate_argnums=0),
    )


def _begin(agent: Agent, key: chex.PRNGKey) -> tuple[chex.Array, chex.Array]:
    words = pack(agents.init(agent, key))
    return words, pack_behavior(agent, words[None]).rows[0]


def _begin_learning(
    learner: LearnerBatch, slot: chex.Array, hyper: RunHyper, words: chex.Array
) -> LearnerBatch:
    return LearnerBatch(
        train=learner.train.at[slot].set(words),
        hyper=learner.hyper.at[slot].set(pack(hyper)),
        memory=replay.begin_run(learner.memory, slot),
    )


def _begin_acting(
    agent: Agent, acting: ActingBatch, slot: chex.Array, hyper: RunHyper, key: chex.PRNGKey
) -> ActingBatch:
    return ActingBatch(
        state=acting.state.at[slot].set(pack(init_acting(agent, hyper, key))),
        hyper=acting.hyper.at[slot].set(pack(hyper)),
    )


def _act(
    act_all: Callable[..., tuple[chex.Array, chex.Array]],
    acting: ActingBatch,
    params: Behavior,
    observation: chex.Array,
    live: chex.Array,
) -> tuple[ActingBatch, chex.Array]:
    state, packed = act_all(acting.state, acting.hyper, params, observation, live)
    return acting._replace(state=state), packed


def _learn(
    learn: Callable[..., tuple[tuple[chex.Array, replay.Replay], PackedBehavior]],
    learner: LearnerBatch,
    frames: chex.Array,
    slots: chex.Array,
    count: chex.Array,
) -> tuple[LearnerBatch, PackedBehavior]:
    before = learner.train, learner.memory
    (train, memory), packed = learn(before, learner.hyper, frames, slots, count)
    return learner._replace(train=train, memory=memory), packed


def _boundaries(agent: Agent, acting: ActingBatch) -> chex.Array:
    like = some_acting(agent)
    return jax.vmap(lambda state: unpack(like, state).boundary)(acting.state)


def _tested_of(agent: Agent, train: chex.Array, slot: chex.Array) -> chex.Array:
    state = unpack(some_train(agent), train[slot])
    behavior = agents.behavior(as_tested(state))
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(behavior)])


def _diagnose(agent: Agent, learner: LearnerBatch, slots: chex.Array) -> Metrics:
    def one(slot: chex.Array) -> Metrics:
        state = unpack(some_train(agent), learner.train[slot])
        hyper = unpack(some_hyper(agent), learner.hyper[slot])
        return diagnose(agent, hyper, state, learner.memory, slot)

    if len(slots) > 1:
        metrics: Metrics = jax.vmap(one)(slots)
        return metrics
    return {name: value[None] for name, value in one(slots[0]).items()}


def _restore(
    learner: LearnerBatch, slot: chex.Array, words: chex.Array, ring: chex.Array, start: chex.Array
) -> LearnerBatch:
    return learner._replace(
        train=learner.train.at[slot].set(words),
        memory=replay.restore(learner.memory, slot, ring, start),
    )


def _begin_ring(learner: LearnerBatch, cursor: chex.Array) -> LearnerBatch:
    memory = dataclasses.replace(learner.memory, cursor=jnp.asarray(cursor, jnp.int32))
    return learner._replace(memory=memory)


def _restore_acting(acting: ActingBatch, slot: chex.Array, words: chex.Array) -> ActingBatch:
    return acting._replace(state=acting.state.at[slot].set(words))


def _put_behavior(packed: PackedBehavior, slot: chex.Array, row: chex.Array) -> PackedBehavior:
    return PackedBehavior(
        rows=packed.rows.at[slot].set(row),
        finite=packed.finite.at[slot].set(jnp.isfinite(row).all()),
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
    before, settings = unpack(some_acting(agent), state), unpack(some_hyper(agent), hyper)
    after, packed = act_or_begin(agent, settings, params, before, observation, live)
    return pack(after), packed
