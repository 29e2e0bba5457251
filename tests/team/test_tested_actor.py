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
from hitl_jax.team import agent as agents
from hitl_jax.team import parts
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


def test_the_average_is_polyaks():
    agent = agents.make_agent(paper_config(**_SIZES, tested_actor="average"))
    before, after = _updated(agent)
    by_hand = jax.tree.map(
        lambda old, new: 0.75 * old + 0.25 * new, before.learner.actor, after.learner.actor
    )
    chex.assert_trees_all_close(parts.tested_actor(agent, after), by_hand, rtol=1e-5, atol=1e-7)


def test_the_last_is_what_acts():
    agent = agents.make_agent(paper_config(**_SIZES, tested_actor="last"))
    _, after = _updated(agent)
    assert parts.tested_actor(agent, after) is after.learner.actor


@dataclasses.dataclass(frozen=True)
class Own:
    """A learner of a user's own, without an average, or with one of its own."""

    inner: object
    average_actor: object = None

    def __getattr__(self, name):
        if name == "inner" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.inner, name)


def _make(average, tested):
    config = paper_config(**_SIZES, tested_actor=tested)
    return agents.make_agent(config, learner=Own(config.task_learner, average))


def test_a_learner_that_keeps_no_average_is_refused():
    _make(None, "last")
    with pytest.raises(InvalidValue, match=r"^tested_actor average: .* must be last$"):
        _make(None, "average")


def _of_another_form(state):
    return state.critic


def _that_fails(state):
    raise RuntimeError("no average")


@pytest.mark.parametrize(
    ("average", "said"),
    [(_of_another_form, "of the form of actor"), (_that_fails, "RuntimeError: no average")],
)
def test_an_average_that_cannot_act_is_refused(average, said):
    _make(average, "last")
    with pytest.raises(InvalidValue, match=f"^learner .*{said}"):
        _make(average, "average")


@pytest.mark.parametrize("value", ["mean", "", None, 1])
def test_other_words_are_refused(value):
    with pytest.raises(InvalidValue, match="tested_actor"):
        AgentConfig(tested_actor=value)
