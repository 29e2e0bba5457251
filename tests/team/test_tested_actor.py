"""Which actor is tested and kept: that of the last update, or the average of the last updates."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import AgentConfig, Method, hyper_for
from hitl_jax.errors import InvalidValue
from hitl_jax.team import agent as agents
from hitl_jax.types import Transition

_SIZES = {"learner": "td3", "hidden_sizes": (8,), "boundary_hidden_sizes": (8,)}


def _updated(agent):
    rng = np.random.default_rng(0)
    hyper = hyper_for(Method.SRL, paper_hyper(target_step_size=0.25))
    batch = Transition(
        observation=jnp.asarray(rng.normal(size=(8, 24)), jnp.float32),
        action=jnp.asarray(rng.uniform(-1, 1, (8, 4)), jnp.float32),
        reward=jnp.ones(8),
        discount=jnp.zeros(8),
        next_observation=jnp.zeros((8, 24)),
    )
    before = agents.init(agent, jax.random.key(0))
    return before, agents.update(agent, hyper, before, batch, jnp.zeros((8, 4)), True)[0]


def test_the_average_is_polyaks_and_all_else_stays():
    agent = agents.make_agent(paper_config(**_SIZES, tested_actor="average"))
    before, after = _updated(agent)
    tested = agents.as_tested(agent, after)
    by_hand = jax.tree.map(
        lambda old, new: 0.75 * old + 0.25 * new, before.learner.actor, after.learner.actor
    )
    for told, expected in zip(
        jax.tree.leaves(tested.learner.actor), jax.tree.leaves(by_hand), strict=True
    ):
        np.testing.assert_allclose(told, expected, rtol=1e-5, atol=1e-7)
    back = dataclasses.replace(
        tested, learner=dataclasses.replace(tested.learner, actor=after.learner.actor)
    )
    assert back == after


def test_the_last_is_what_acts():
    agent = agents.make_agent(paper_config(**_SIZES, tested_actor="last"))
    _, after = _updated(agent)
    assert agents.as_tested(agent, after) is after


def test_a_learner_that_keeps_no_average_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Forgetful:
        inner: object

        def __getattr__(self, name):
            if name in ("tested_actor", "inner") or name.startswith("__"):
                raise AttributeError(name)
            return getattr(self.inner, name)

    forgetful = Forgetful(paper_config(**_SIZES).task_learner)
    agents.make_agent(paper_config(**_SIZES, tested_actor="last"), learner=forgetful)
    with pytest.raises(InvalidValue, match=r"^tested_actor average: .* must be last$"):
        agents.make_agent(paper_config(**_SIZES, tested_actor="average"), learner=forgetful)


def test_an_average_of_another_shape_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Wrong:
        inner: object

        def __getattr__(self, name):
            if name == "inner" or name.startswith("__"):
                raise AttributeError(name)
            return getattr(self.inner, name)

        def tested_actor(self, state):
            return state.critic

    with pytest.raises(InvalidValue, match="tested_actor"):
        agents.make_agent(
            paper_config(**_SIZES), learner=Wrong(paper_config(**_SIZES).task_learner)
        )


@pytest.mark.parametrize("value", ["mean", "", None, 1])
def test_other_words_are_refused(value):
    with pytest.raises(InvalidValue, match="tested_actor"):
        AgentConfig(tested_actor=value)
