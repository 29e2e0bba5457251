"""Which actor is tested and kept: that of the last update, or the average of the last updates."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import AgentConfig, Method, hyper_for
from hitl_jax.errors import InvalidValue
from hitl_jax.team import agent as agents
from hitl_jax.team import parts
from hitl_jax.types import Transition

_SIZES = {"learner": "td3", "hidden_sizes": (8,), "boundary_hidden_sizes": (8,)}


def _updated(tested, last=True):
    """A run's state before and after an update, or after one that does not touch the actor."""
    agent = agents.make_agent(paper_config(**_SIZES, tested_actor=tested))
    rng = np.random.default_rng(0)
    hyper = hyper_for(Method.SRL, paper_hyper(average_step_size=0.25))
    batch = Transition(
        observation=jnp.asarray(rng.normal(size=(8, 24)), jnp.float32),
        action=jnp.asarray(rng.uniform(-1, 1, (8, 4)), jnp.float32),
        reward=jnp.ones(8),
        discount=jnp.zeros(8),
        next_observation=jnp.zeros((8, 24)),
    )
    before = agents.init(agent, jax.random.key(0))
    return before, agents.update(agent, hyper, before, batch, jnp.zeros((8, 4)), last)[0]


def test_the_average_is_polyaks():
    before, after = _updated("average")
    by_hand = jax.tree.map(
        lambda old, new: 0.75 * old + 0.25 * new, before.learner.actor, after.learner.actor
    )
    chex.assert_trees_all_close(parts.tested(after).learner.actor, by_hand, rtol=1e-5, atol=1e-7)
    chex.assert_trees_all_equal(parts.tested(after).learner.critic, after.learner.critic)


def test_it_moves_with_the_actor_alone():
    before, after = _updated("average", last=False)
    chex.assert_trees_all_equal(before.average_actor, after.average_actor)


def test_what_acts_and_learns_is_the_same():
    (_, average), (_, last) = _updated("average"), _updated("last")
    chex.assert_trees_all_equal(average.learner, last.learner)
    chex.assert_trees_all_equal(agents.behavior(average), agents.behavior(last))


def test_the_last_is_what_acts():
    _, after = _updated("last")
    assert after.average_actor is None
    assert parts.tested(after) is after


@pytest.mark.parametrize("value", ["mean", "", None, 1])
def test_other_words_are_refused(value):
    with pytest.raises(InvalidValue, match="tested_actor"):
        AgentConfig(tested_actor=value)
