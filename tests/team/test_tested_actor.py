"""Which actor is tested and kept: that of the last update, or the average of the last updates."""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import AgentConfig, Method, hyper_for
from hitl_jax.errors import InvalidValue
from hitl_jax.live.options import LiveOptions
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.team import agent as agents
from hitl_jax.team import parts
from hitl_jax.types import Transition

_SIZES = {"learner": "td3", "hidden_sizes": (8,), "boundary_hidden_sizes": (8,)}


def _updated(tested, last=True, count=1):
    """A run's states before and after updates, or after some that do not touch the actor."""
    agent = agents.make_agent(paper_config(**_SIZES, tested_actor=tested))
    rng = np.random.default_rng(0)
    hyper = hyper_for(Method.SRL, paper_hyper(average_step_size=0.4))
    batch = Transition(
        observation=jnp.asarray(rng.normal(size=(8, 24)), jnp.float32),
        action=jnp.asarray(rng.uniform(-1, 1, (8, 4)), jnp.float32),
        reward=jnp.ones(8),
        discount=jnp.zeros(8),
        next_observation=jnp.zeros((8, 24)),
    )
    update = jax.jit(agents.update, static_argnums=(0, 5))
    states = [agents.init(agent, jax.random.key(0))]
    for _ in range(count):
        states.append(update(agent, hyper, states[-1], batch, jnp.zeros((8, 4)), last)[0])
    return states


def test_the_average_is_polyaks_and_at_the_start_the_mean():
    states = _updated("average", count=3)
    actors = [state.learner.actor for state in states[1:]]
    by_hand = jax.tree.map(lambda a, b, c: 0.6 * (a + b) / 2 + 0.4 * c, *actors)
    kept = parts.as_tested(states[-1]).learner
    chex.assert_trees_all_close(kept.actor, by_hand, rtol=1e-5, atol=1e-7)
    chex.assert_trees_all_equal(kept.critic, states[-1].learner.critic)


def test_it_moves_with_the_actor_alone():
    before, after = _updated("average", last=False)
    chex.assert_trees_all_equal(before.average, after.average)


def test_what_acts_and_learns_is_the_same():
    (_, average), (_, last) = _updated("average"), _updated("last")
    chex.assert_trees_all_equal(average.learner, last.learner)
    chex.assert_trees_all_equal(agents.behavior(average), agents.behavior(last))


def test_the_last_is_what_acts():
    _, after = _updated("last")
    assert after.average is None
    assert parts.as_tested(after) is after


def test_the_step_of_an_average_that_is_not_tested_is_refused():
    usual, hyper = SweepOptions(), paper_hyper(average_step_size=0.1)
    average = dataclasses.replace(usual.agent, tested_actor="average")
    dataclasses.replace(usual, agent=average, hyper=hyper).checked()
    last = dataclasses.replace(usual.agent, tested_actor="last")
    with pytest.raises(InvalidValue, match=r"^average_step_size 0\.1: .*tested_actor"):
        dataclasses.replace(usual, agent=last, hyper=hyper).checked()
    with pytest.raises(InvalidValue, match=r"^average_step_size 0\.1: .*tested_actor"):
        dataclasses.replace(LiveOptions(), agent=last, hyper=hyper).checked()


@pytest.mark.parametrize("value", ["mean", "", None, 1])
def test_other_words_are_refused(value):
    with pytest.raises(InvalidValue, match="tested_actor"):
        AgentConfig(tested_actor=value)
