import compiled
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct, traverse_util
from paper_team import paper_config

from hitl_jax.learner.networks import Actor
from hitl_jax.team import agent as agents
from hitl_jax.team import checkpoint
from hitl_jax.team.array_names import by_name, from_names


@pytest.fixture
def saved(tmp_path):
    agent = agents.make_agent(paper_config(hidden_sizes=(16, 8)))
    train = compiled.init(agent, jax.random.key(0))
    path = tmp_path / "params.npz"
    np.savez(path, **checkpoint.flatten(train, np.float32(0.4)))
    return path, train


def test_round_trip(saved):
    path, train = saved
    agent = agents.make_agent(paper_config(hidden_sizes=(16, 8)))
    networks = checkpoint.networks_of(agent, checkpoint.load(path))
    jax.tree.map(np.testing.assert_array_equal, networks["actor"], train.learner.actor)
    jax.tree.map(np.testing.assert_array_equal, networks["boundary_critic"], train.boundary.critic)
    assert networks["boundary"] == np.float32(0.4)


def test_names_are_those_of_the_layers(saved):
    _, train = saved
    names = set(checkpoint.flatten(train, np.float32(0.4)))
    networks = {
        "actor": train.learner.actor,
        "critic": train.learner.critic,
        "boundary_actor": train.boundary.actor,
        "boundary_critic": train.boundary.critic,
    }
    assert names == {*traverse_util.flatten_dict(networks, sep="/"), "boundary"}
    assert "actor/params/Dense_0/kernel" in names


@struct.dataclass
class _Linear:
    weight: jax.Array
    bias: jax.Array


@pytest.mark.parametrize(
    ("actor", "names"),
    [
        ([(1.0, 2.0), (3.0, 4.0)], ["actor/0/0", "actor/0/1", "actor/1/0", "actor/1/1"]),
        ({"first": _Linear(1.0, 2.0)}, ["actor/first/weight", "actor/first/bias"]),
        (1.0, ["actor"]),
    ],
)
def test_networks_may_be_any_pytree(actor, names):
    actor = jax.tree.map(jnp.float32, actor)
    arrays = by_name({"actor": actor})
    assert list(arrays) == names
    back = from_names({"actor": actor}, arrays)
    assert jax.tree.structure(back) == jax.tree.structure({"actor": actor})
    jax.tree.map(np.testing.assert_array_equal, back["actor"], actor)


def test_two_arrays_of_one_name_are_refused():
    with pytest.raises(ValueError, match="array 'a/b': must have a name of its own"):
        by_name({"a": {"b": 1.0}, "a/b": 2.0})


def test_a_learner_in_plain_jax_comes_back():
    agent = agents.make_agent(paper_config(learner="my_plain:plain", boundary_hidden_sizes=(4,)))
    train = compiled.init(agent, jax.random.key(0))
    back = checkpoint.networks_of(agent, checkpoint.flatten(train, np.float32(0.4)))
    jax.tree.map(np.testing.assert_array_equal, back["actor"], train.learner.actor)
    jax.tree.map(np.testing.assert_array_equal, back["critic"], train.learner.critic)


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
