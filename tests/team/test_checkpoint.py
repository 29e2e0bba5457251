import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitl_jax.config import AgentConfig
from hitl_jax.learner.networks import Actor
from hitl_jax.team import agent as agents
from hitl_jax.team import checkpoint


@pytest.fixture
def saved(tmp_path):
    agent = agents.make_agent(AgentConfig(hidden_sizes=(16, 8)))
    train = agents.init(agent, jax.random.key(0))
    path = tmp_path / "params.npz"
    np.savez(path, **checkpoint.flatten(train, np.float32(0.4)))
    return path, train


def test_round_trip(saved):
    path, train = saved
    agent = agents.make_agent(AgentConfig(hidden_sizes=(16, 8)))
    networks = checkpoint.networks_of(agent, checkpoint.load(path))
    jax.tree.map(np.testing.assert_array_equal, networks["actor"], train.learner.actor)
    jax.tree.map(np.testing.assert_array_equal, networks["boundary_critic"], train.boundary.critic)
    assert networks["boundary"] == np.float32(0.4)


def test_the_actor_acts_as_it_did(saved):
    path, train = saved
    actor = checkpoint.load_actor(path, 24, 4)
    *hidden, size = checkpoint.hidden_sizes(actor)
    assert (hidden, size) == ([16, 8], 4)
    observation = jnp.ones(24)
    np.testing.assert_array_equal(
        Actor(tuple(hidden), size).apply(actor, observation),
        Actor((16, 8), 4).apply(train.learner.actor, observation),
    )


def test_what_is_no_checkpoint_is_named(saved, tmp_path):
    path, _ = saved
    text = tmp_path / "text.npz"
    text.write_text("not an archive")
    cut = tmp_path / "cut.npz"
    cut.write_bytes(path.read_bytes()[:500])
    empty = tmp_path / "empty.npz"
    np.savez(empty, other=np.zeros(3))
    for bad in (text, cut, tmp_path, tmp_path / "missing.npz"):
        with pytest.raises(ValueError, match="is no checkpoint that can be read"):
            checkpoint.load_actor(bad, 24, 4)
    with pytest.raises(ValueError, match="holds no actor"):
        checkpoint.load_actor(empty, 24, 4)
    np.savez(empty, **{"actor/weights": np.zeros(3)})
    with pytest.raises(ValueError, match="its actor is not one of this program"):
        checkpoint.load_actor(empty, 24, 4)
    with pytest.raises(ValueError, match="has 24 observations and 4 actions"):
        checkpoint.load_actor(path, 8, 2)
