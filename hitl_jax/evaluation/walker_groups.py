"""Groups of test walkers on a device: what they begin with, and the program of their chunks."""

import functools
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp

from hitl_jax.config import RunHyper
from hitl_jax.envs import StepBatch
from hitl_jax.evaluation.trials import init_test
from hitl_jax.learner.frame import Layout
from hitl_jax.team import packed_decision
from hitl_jax.team.acting import ActingState
from hitl_jax.team.agent import Agent
from hitl_jax.training import batch_arrays, device_ticks
from hitl_jax.training.device_ticks import ChunkStart
from hitl_jax.types import Behavior

GROUP = 16
"""Episodes of one policy that are acted for together."""


class Policy(NamedTuple):
    """What acting needs to know of a policy under test."""

    hyper: RunHyper
    params: Behavior


class GroupStates(NamedTuple):
    """What G groups begin a chunk with.

    Attributes:
        policies: leaves [G, ...].
        acting: acting states, leaves [G, 16, ...].
        begin: of the walkers, leaves [G, 16, ...].
        seeds: of their resets, uint32 [G, 16].
    """

    policies: Policy
    acting: ActingState
    begin: ChunkStart
    seeds: chex.Array


class GroupStart(NamedTuple):
    """A policy and its episodes, with what their acting begins from; see `init_test`.

    Attributes:
        policy: leaves [...].
        boundary: the boundary source's carry, [] or [C].
        run: seed and method of the run, see `batch_arrays.traced_run_keys`, uint32 [2].
        episodes: their numbers, [16].
        plays: whether an episode is one of the test's, bool [16].
        seeds: of their resets, uint32 [16].
    """

    policy: Policy
    boundary: chex.Array
    run: chex.Array
    episodes: chex.Array
    plays: chex.Array
    seeds: chex.Array


class Told(NamedTuple):
    """What L walkers did in a chunk of U ticks.

    Attributes:
        steps: from the action on, with what the walkers answered, [L, U, A + 13].
        stepped: whether that is a step of an episode, bool [L, U].
        ended: whether an episode ended, bool [L].
        lost: whether one met a number that is not finite, bool [L].
    """

    steps: chex.Array
    stepped: chex.Array
    ended: chex.Array
    lost: chex.Array


def _begun(agent: Agent, start: GroupStart) -> GroupStates:
    """One group at the first step of its episodes, policy leaves [...], others [16, ...]."""
    *_, key = batch_arrays.traced_run_keys(*start.run)
    one = functools.partial(init_test, agent, start.policy.hyper, start.boundary, key)
    begin = ChunkStart(
        active=start.plays,
        needs_reset=start.plays,
        left=jnp.ones(GROUP, jnp.int32),
        observation=jnp.zeros((GROUP, agent.layout.observation_size), jnp.float32),
    )
    return GroupStates(start.policy, jax.vmap(one)(start.episodes), begin, start.seeds)


@functools.partial(jax.jit, static_argnums=(0, 1))
def waiting(agent: Agent, count: int, starts: GroupStart) -> GroupStates:
    """Groups that play nothing, each with the first policy of several."""
    begun = _begun(agent, jax.tree.map(lambda leaf: leaf[0], starts))
    states: GroupStates = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), begun
    )
    idle = jnp.zeros((count, GROUP), bool)
    return states._replace(begin=states.begin._replace(active=idle, needs_reset=idle))


@functools.partial(jax.jit, static_argnums=0, donate_argnums=1)
def put(agent: Agent, states: GroupStates, places: chex.Array, starts: GroupStart) -> GroupStates:
    """Starts, leaves [K, ...], put in the places of groups, [K]."""
    begun = jax.vmap(functools.partial(_begun, agent))(starts)
    after: GroupStates = jax.tree.map(lambda leaf, new: leaf.at[places].set(new), states, begun)
    return after


def play_groups(
    agent: Agent,
    count: int,
    policies: Policy,
    acting: ActingState,
    begin: ChunkStart,
    seeds: chex.Array,
    walkers: chex.ArrayTree,
) -> tuple[ActingState, ChunkStart, chex.ArrayTree, Told]:
    """A chunk of ticks of L walkers in G groups; see `device_ticks.play`."""
    step = functools.partial(packed_decision.act_or_begin, agent)
    group = jax.vmap(step, in_axes=(None, None, 0, 0, 0))

    def act(
        states: ActingState, observation: chex.Array, live: chex.Array
    ) -> tuple[ActingState, chex.Array]:
        seen, stepping = (a.reshape(-1, GROUP, *a.shape[1:]) for a in (observation, live))
        after, decided = jax.vmap(group)(*policies, states, seen, stepping)

        def unless_idle(new: chex.Array, old: chex.Array) -> chex.Array:
            # An episode has begun already, by `init_test`.
            return jnp.where(stepping.reshape(*stepping.shape, *[1] * (old.ndim - 2)), new, old)

        states = jax.tree.map(unless_idle, after, states)
        return states, decided.reshape(len(live), -1)

    flat = ChunkStart(*(leaf.reshape(-1, *leaf.shape[2:]) for leaf in begin))
    first_left = jnp.ones_like(flat.left)
    acting, walkers, end, (decided, live, *played) = device_ticks.play(
        act, agent.layout, count, acting, walkers, flat, seeds.reshape(-1, 1), first_left
    )
    ended = flat.left > end.left
    told = Told(
        steps=_logged(decided, StepBatch(*played), agent.layout),
        stepped=live.T,
        ended=ended,
        lost=flat.active & ~end.active & ~ended,
    )
    begin = ChunkStart(*(leaf.reshape(-1, GROUP, *leaf.shape[1:]) for leaf in end))
    return acting, begin, walkers, told


def _logged(decided: chex.Array, answer: StepBatch, layout: Layout) -> chex.Array:
    """What is logged of ticks [U, L, W + 6], [L, U, A + 13]."""
    columns = {
        layout.reward: answer.reward,
        layout.terminated: answer.terminated,
        layout.truncated: answer.truncated,
    }
    for column, values in columns.items():
        decided = decided.at[..., column].set(values.astype(decided.dtype))
    return decided[..., layout.action.start :].swapaxes(0, 1)
