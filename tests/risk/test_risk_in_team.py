"""The risk critic beside the other learners: who learns it, who sees it, what is saved."""

import dataclasses

import compiled
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.learner import replay
from hitl_jax.learner.frame import FALL
from hitl_jax.team import agent as agents
from hitl_jax.team import checkpoint
from hitl_jax.team.acting import act, init_acting
from hitl_jax.team.agent import make_agent

_CONFIG = paper_config(
    hidden_sizes=(8,), boundary_hidden_sizes=(4,), risk_hidden_sizes=(8,), batch_size=8
)
_TEAM = make_agent(dataclasses.replace(_CONFIG, indicator="fall_risk"))
_KEY = jax.random.key(5)


@pytest.fixture(scope="module")
def memory():
    layout, rng = _TEAM.layout, np.random.default_rng(0)
    frames = np.zeros((1, 256, layout.width), np.float32)
    frames[..., layout.observation] = rng.normal(size=(1, 256, 24))
    frames[:, ::40, layout.event] = FALL
    return replay.add(replay.init(256, 1, layout), frames)


def _learned(team, method, memory):
    state = compiled.init(team, _KEY)
    hyper = hyper_for(method, paper_hyper())
    return state, compiled.learn(team, hyper, state, memory, jnp.int32(0), 2)


def _same(one, other):
    return jax.tree.all(jax.tree.map(np.array_equal, one, other))


@pytest.mark.parametrize("method", Method)
def test_it_is_learned_where_there_is_an_arbiter(method, memory):
    before, after = _learned(_TEAM, method, memory)
    assert _same(before.risk.critic, after.risk.critic) == (method is Method.SRL)
    moved = jnp.abs(after.risk.critic.offset) + jnp.abs(after.risk.critic.slope)
    assert (float(moved) > 0.0) == (method is not Method.SRL)


def test_the_other_learners_are_as_without_it(memory):
    _, beside = _learned(_TEAM, Method.HITL_AC, memory)
    _, alone = _learned(make_agent(_CONFIG), Method.HITL_AC, memory)
    assert alone.risk is None
    assert _same(beside.learner, alone.learner)
    assert _same(beside.boundary, alone.boundary)


def test_the_alarm_is_raised_by_the_risk():
    behavior = agents.behavior(compiled.init(_TEAM, _KEY))
    seen = jax.random.normal(jax.random.key(1), (24,))
    risk = float(_TEAM.risk_learner.risk(behavior.risk, seen))
    assert float(_TEAM.safety_indicator(behavior, seen)) == risk
    for boundary, alarmed in ((0.99 * risk, True), (1.01 * risk, False)):
        hyper = hyper_for(Method.HITL_FIX, paper_hyper(initial_boundary=boundary))
        _, decision = act(_TEAM, hyper, behavior, init_acting(_TEAM, hyper, _KEY), seen)
        assert bool(decision.alarmed) is alarmed


def test_it_is_saved_with_the_networks_and_comes_back():
    state = compiled.init(_TEAM, _KEY)
    arrays = checkpoint.flatten(state, np.float32(0.5))
    assert {"risk/network/params/Dense_0/kernel", "risk/slope", "risk/offset"} <= set(arrays)
    back = checkpoint.networks_of(_TEAM, arrays)["risk"]
    assert _same(jax.tree.leaves(back), jax.tree.leaves(state.risk.critic))
    assert not any(name.startswith("risk") for name in _names_alone())


def _names_alone():
    return checkpoint.flatten(compiled.init(make_agent(_CONFIG), _KEY), np.float32(0.5))
