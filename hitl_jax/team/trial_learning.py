"""A task learner tried once, by shapes alone: its state, its actions, its updates, its metrics."""

import functools
from typing import Any

import chex
import jax
import jax.numpy as jnp

from hitl_jax.config import RunHyper
from hitl_jax.human.caller_state import form
from hitl_jax.learner.task_learner import TaskLearner
from hitl_jax.team.array_names import by_name
from hitl_jax.team.diagnostics import SAMPLE, require_metrics
from hitl_jax.team.parts import Agent
from hitl_jax.team.trial_shapes import Blamed, Given, Sizes, floats, given_of
from hitl_jax.types import Transition
from hitl_jax.xla.pytree_words import pack


@functools.lru_cache(maxsize=8)
def state_of_learner(learner: TaskLearner, sizes: Sizes, told: str) -> Any:
    """Tries a learner: once, since it takes longer than all else of a team.

    Args:
        learner: of the team.
        sizes: of the team.
        told: the learner's name in messages.

    Returns:
        Its state, as shapes.

    Raises:
        InvalidValue: one line with the learner and what is wrong with it.
    """
    blamed, given = Blamed("learner", told), given_of(sizes)
    state = blamed.shapes(learner.init, given.key, given.key)
    _require_state(blamed, state)
    back = blamed.shapes(
        lambda state: learner.with_networks(state, state.actor, state.critic), state
    )
    blamed.require_same("with_networks", state, back)
    action = blamed.shapes(
        learner.act, given.hyper, state.actor, given.seen, given.noise, given.number
    )
    blamed.require(action, f"{sizes.action_size} actions", given.noise.shape)
    # One as it learns, which is no last one where there are others, and one as it is measured:
    # tracing both kinds of both would take twice as long.
    _improve(blamed, learner, given, state, sizes.batch_size, learner.policy_delay)
    metrics = _improve(blamed, learner, given, state, SAMPLE, 1)
    try:
        require_metrics(metrics)
    except ValueError as error:
        raise blamed.refuse(str(error)) from error
    return state


def _require_state(blamed: Blamed, state: Any) -> None:
    """Refuses a state that cannot act, or be saved."""
    for name in ("actor", "critic"):
        if not hasattr(state, name):
            raise blamed.refuse(f"init must give a state with {name}, gives {form(state)}")
        for leaf in jax.tree.leaves(getattr(state, name)):
            if leaf.dtype != jnp.float32:
                raise blamed.refuse(f"its {name} must be of float32, holds {form(leaf)}")
    if not jax.tree.leaves(state.actor):
        raise blamed.refuse("its actor holds no array")
    try:
        by_name({"actor": state.actor, "critic": state.critic})
    except ValueError as error:
        raise blamed.refuse(str(error)) from error
    blamed.shapes(pack, state)


def _improve(
    blamed: Blamed, learner: TaskLearner, given: Given, state: Any, size: int, count: int
) -> Any:
    """Tries the first of some updates that share targets; gives its metrics.

    Args:
        blamed: the learner, for messages.
        learner: the learner.
        given: what it is called with.
        state: of the learner.
        size: transitions in a minibatch.
        count: of updates.
    """
    rows = size * count
    noise = floats(rows, learner.noise_size)
    targets = blamed.shapes(learner.targets, given.hyper, state, _batch(given, rows), noise)
    if any(leaf.shape[-1:] != (rows,) for leaf in jax.tree.leaves(targets)):
        held = ", ".join(form(leaf) for leaf in jax.tree.leaves(targets))
        raise blamed.refuse(f"targets of {rows} transitions must be [..., {rows}], are {held}")
    one = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct((*leaf.shape[:-1], size), leaf.dtype), targets
    )

    def improve(
        hyper: RunHyper, state: Any, batch: Transition, target: chex.ArrayTree, noise: chex.Array
    ) -> Any:
        return learner.improve(hyper, state, batch, target, noise, count == 1)

    noise = floats(size, learner.noise_size)
    improved = blamed.shapes(improve, given.hyper, state, _batch(given, size), one, noise)
    if not (isinstance(improved, tuple) and len(improved) == 2):
        raise blamed.refuse(f"improve must give (state, metrics), gives {form(improved)}")
    after, metrics = improved
    blamed.require_same("improve", state, after)
    return metrics


def try_human_data(agent: Agent, given: Given) -> None:
    """Tries what is made of the human's steps; see `state_of_learner`."""
    chosen, rows = agent.human_data, agent.config.batch_size
    blamed = Blamed("human_data", agent.config.human_data)
    if chosen.changes_critic:
        values, batch = floats(2, rows), _batch(given, rows)
        loss = blamed.shapes(chosen.critic_loss, given.hyper.extra, values, values, batch)
        blamed.require(loss, "one number")
    if chosen.changes_actor:
        action = floats(rows, *given.noise.shape)
        loss = blamed.shapes(chosen.actor_loss, given.hyper.extra, action, _batch(given, rows))
        blamed.require(loss, "one number")


def _batch(given: Given, rows: int) -> Transition:
    seen = floats(rows, *given.seen.shape)
    return Transition(
        observation=seen,
        action=floats(rows, *given.noise.shape),
        reward=floats(rows),
        discount=floats(rows),
        next_observation=seen,
        human=floats(rows),
    )
