"""A team with the margin's learner: that it learns, and what is refused."""

import functools

import compiled
import jax
import numpy as np
import pytest

from hitl_jax.boundary.margin import MarginLearner
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.errors import InvalidValue
from hitl_jax.learner import replay
from hitl_jax.team import agent as agents
from hitl_jax.training.run_spec import LoopConfig


def test_a_team_learns_with_it():
    config = AgentConfig(
        learner="td3",
        hidden_sizes=(8,),
        batch_size=8,
        boundary_learner="margin",
        boundary_source="network",
        boundary_hidden_sizes=(8,),
        boundary_batch_size=8,
        indicator="fall_risk",
    )
    agent = agents.make_agent(config)
    layout = agent.layout
    frames = np.random.default_rng(0).normal(size=(1, 128, layout.width)).astype(np.float32)
    frames[..., layout.terminated : layout.final + 1] = 0.0
    frames[..., layout.event] = 0.0
    memory = replay.add(replay.begin_run(replay.init(128, 1, layout), 0), frames)
    state = compiled.init(agent, jax.random.key(0))
    learn = jax.jit(functools.partial(agents.learn, agent), static_argnums=4)
    for method in Method:
        after = learn(hyper_for(method, Hyper()), state, memory, 0, 4)
        changed = jax.tree.map(
            lambda a, b: bool((a != b).any()), after.boundary.actor, state.boundary.actor
        )
        assert any(jax.tree.leaves(changed)) is (method is Method.HITL_AC)
        assert np.isfinite(jax.tree.reduce(lambda a, b: a + b.sum(), after.boundary.critic, 0.0))


def test_unknown_parts_are_one_line():
    with pytest.raises(InvalidValue, match=r"^margin_parts x: must be one of heavy_tails, often"):
        AgentConfig(margin_parts=("x",))
    with pytest.raises(InvalidValue, match=r"^margin_parts often often: each at most once$"):
        AgentConfig(margin_parts=("often", "often"))
    assert agents.make_agent(
        AgentConfig(boundary_learner="margin", margin_parts=())
    ).boundary_learner


def test_a_replay_that_holds_no_takeover_is_refused():
    least = MarginLearner(2, (32,)).least_frames
    with pytest.raises(InvalidValue, match=r"^capacity 96: must be at least 128 with"):
        LoopConfig(capacity=96).require_frames(least, "margin")
    LoopConfig(capacity=128).require_frames(least, "margin")


def test_an_unknown_learner_is_one_line():
    with pytest.raises(
        InvalidValue, match=r"^boundary_learner x: must be one of printed, margin, or"
    ):
        AgentConfig(boundary_learner="x")
