"""What is measured of a run's learners, and that to look changes nothing."""

import compiled
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper
from toy import ToyPool

from hitl_jax.config import Method, hyper_for, typed
from hitl_jax.learner import replay
from hitl_jax.learner.losses import critic_loss, target_q
from hitl_jax.team import agent as agents
from hitl_jax.team import diagnostics
from hitl_jax.training import rollout
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec

_CONFIG = paper_config(
    learner="ddpg",
    hidden_sizes=(8,),
    batch_size=8,
    n_step=1,
    boundary_hidden_sizes=(8,),
    boundary_batch_size=8,
)
_AGENT = agents.make_agent(_CONFIG)


def _memory():
    """One run's replay of one transition, sixty-four times: any sample is of it alone."""
    layout = _AGENT.layout
    frames = np.zeros((1, 64, layout.width), np.float32)
    frames[..., layout.observation] = np.linspace(-1.0, 1.0, 24)
    frames[..., layout.action] = 0.5
    frames[..., layout.reward] = 2.0
    frames[..., layout.boundary] = frames[..., layout.next_boundary] = 0.7
    return replay.add(replay.init(64, 1, layout), frames), frames[0, 0]


@pytest.mark.parametrize("method", list(Method))
def test_metrics_are_those_of_the_sample(method):
    hyper = typed(_AGENT.with_extra(hyper_for(method, paper_hyper())))
    state = compiled.init(_AGENT, jax.random.key(0))
    memory, frame = _memory()
    metrics = jax.jit(diagnostics.diagnose, static_argnums=0)(
        _AGENT, hyper, state, memory, jnp.int32(0)
    )
    seen = jnp.asarray(frame[_AGENT.layout.observation])[None]
    learner, networks = state.learner, _AGENT.learner
    next_action = networks.actor.apply(learner.actor, seen)
    value = networks.critic.apply(learner.critic, seen, jnp.full((1, 4), 0.5))
    target = target_q(
        jnp.array([2.0]),
        jnp.array([0.98]),
        networks.critic.apply(learner.critic, seen, next_action),
    )
    np.testing.assert_allclose(metrics["q"], value.mean(), rtol=1e-5)
    np.testing.assert_allclose(metrics["critic_loss"], jnp.square(value - target).mean(), rtol=1e-5)
    batch = type(_batch())(
        *(jnp.asarray(leaf) for leaf in (seen, jnp.full((1, 4), 0.5), [2.0], [0.98], seen))
    )
    grads = jax.grad(critic_loss, has_aux=True)(
        learner.critic, networks.critic.apply, batch, target
    )[0]
    norm = np.sqrt(sum(np.square(leaf).sum() for leaf in jax.tree.leaves(grads)))
    np.testing.assert_allclose(metrics["critic_gradient_norm"], norm, rtol=1e-4)
    known = method is Method.HITL_AC
    for name in ("boundary_critic_loss", "boundary_actor_gradient_norm", "network_boundary"):
        assert np.isfinite(metrics[name]) == known
    if known:
        np.testing.assert_allclose(metrics["network_boundary_spread"], 0.0, atol=1e-6)


def _batch():
    memory, _ = _memory()
    drawn = replay.draw(memory, _AGENT.layout, 0, jax.random.key(0), 1, 1, 0.98)
    return replay.read(memory, _AGENT.layout, 0, drawn)


def _play(monkeypatch, every):
    monkeypatch.setattr(rollout, "EVERY", every)
    hyper = hyper_for(Method.HITL_AC, paper_hyper(warmup_steps=16))
    specs = [RunSpec(Method.HITL_AC, seed, hyper, episodes=12) for seed in range(2)]
    agent = agents.make_agent(
        paper_config(learner="td3", hidden_sizes=(8,), batch_size=8, boundary_hidden_sizes=(8,))
    )
    loop = LoopConfig(capacity=256, chunk=8)
    return [one for done in Rollout(agent, specs, ToyPool(2), loop) for one in done]


@pytest.mark.slow
def test_a_run_can_be_asked_at_any_time():
    hyper = hyper_for(Method.SRL, paper_hyper(warmup_steps=16))
    agent = agents.make_agent(paper_config(learner="td3", hidden_sizes=(8,), batch_size=8))
    specs = [RunSpec(Method.SRL, seed, hyper, episodes=50) for seed in range(2)]
    playing = Rollout(agent, specs, ToyPool(2), LoopConfig(capacity=256, chunk=8))
    chunks = iter(playing)
    for _ in range(5):
        next(chunks)
    first, second = playing.runs()
    told = playing.diagnose(first)
    assert told["updates"] == first.updates > 0
    assert np.isfinite(told["q"]) and np.isfinite(told["actor_gradient_norm"])
    assert np.isnan(told["network_boundary"])  # SRL learns no boundary.
    assert told["q"] != playing.diagnose(second)["q"]
    assert not first.diagnostics


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_fully")
def test_to_look_changes_nothing(monkeypatch):
    often, never = _play(monkeypatch, 8), _play(monkeypatch, 10**9)
    for one, other in zip(often, never, strict=True):
        assert repr(one.run.episodes) == repr(other.run.episodes)  # NaN differs from itself.
        jax.tree.map(np.testing.assert_array_equal, one.train, other.train)
        assert not other.run.diagnostics
        updates = [row["updates"] for row in one.run.diagnostics]
        assert updates == [*range(8, one.run.updates + 1, 8)]
        steps = [row["env_steps"] for row in one.run.diagnostics]
        assert steps == sorted(steps)
