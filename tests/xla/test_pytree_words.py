"""Packing a pytree into words keeps every bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config

from hitl_jax.config import RunHyper, typed
from hitl_jax.team import agent as agents
from hitl_jax.team.acting import init_acting
from hitl_jax.team.agent import make_agent
from hitl_jax.training import batch_arrays, compiled_batch
from hitl_jax.xla.pytree_words import (
    from_pieces,
    pack,
    piece_sizes,
    to_pieces,
    unpack,
    unpack_on_host,
    word_places,
)
from hitl_jax.xla.threefry import make_key


def _bits(tree):
    """Type, shape and bytes of each leaf; keys by their data."""

    def data(leaf):
        key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return jax.random.key_data(leaf) if key else leaf

    return [(leaf.dtype, leaf.shape, np.asarray(data(leaf)).tobytes()) for leaf in tree]


def test_unpacking_gives_every_bit_back():
    tree = {
        "floats": jnp.array([[1.5, -0.0], [jnp.inf, jnp.nan]]),
        "most": jnp.int32(2**31 - 1),
        "negative": jnp.int32(-1),
        "flags": jnp.array([True, False]),
        "none": jnp.zeros((0, 3)),
        "key": make_key(7),
        "large": jnp.arange(10_000.0).reshape(100, 100),
        "keys": jax.random.split(make_key(8), 3),
    }
    words = jax.jit(pack)(tree)
    assert (words.dtype, words.shape) == (jnp.uint32, (4 + 1 + 1 + 2 + 2 + 6 + 10_000,))
    back = jax.jit(unpack)(tree, words)
    assert jax.tree.structure(back) == jax.tree.structure(tree)
    assert _bits(jax.tree.leaves(back)) == _bits(jax.tree.leaves(tree))
    assert jax.random.uniform(back["key"]) == jax.random.uniform(make_key(7))


@pytest.mark.parametrize("small", [{}, {"bias": jnp.ones(3), "key": make_key(1)}])
@pytest.mark.parametrize("large", [{}, {"a": jnp.ones((128, 128)), "z": jnp.zeros(9000)}])
def test_pieces_joined_are_the_packed_words(small, large):
    tree = {**small, "middle": jnp.int32(7), **large}
    pieces = to_pieces(tree)
    assert [piece.size for piece in pieces] == piece_sizes(tree)
    assert len(pieces) == 1 + len(large)
    np.testing.assert_array_equal(jnp.concatenate(pieces), pack(tree))
    back = from_pieces(tree, pieces)
    assert _bits(jax.tree.leaves(back)) == _bits(jax.tree.leaves(tree))


def test_small_leaves_come_before_large_ones():
    """Saved runs depend on the order: a change of it needs a new `saved_run_store.FORMAT`."""
    tree = [jnp.arange(8192), jnp.arange(2), jnp.arange(9000), jnp.arange(8191)]
    order = [tree[1], tree[3], tree[0], tree[2]]
    np.testing.assert_array_equal(pack(tree), np.concatenate(order))


def test_the_host_unpacks_the_same():
    config = paper_config(indicator="fall_risk", boundary_source="pid")
    train = agents.init(make_agent(config), make_key(0))
    acting = init_acting(make_agent(config), typed(RunHyper()), make_key(3))
    for tree in (
        train,
        jax.tree.map(jnp.asarray, acting),
        {"byte": jnp.arange(3, dtype=jnp.uint8)},
    ):
        words = np.asarray(pack(tree))
        back = unpack_on_host(tree, word_places(tree), words)
        given, found = jax.tree.leaves(tree), jax.tree.leaves(back)
        assert all(isinstance(leaf, np.ndarray) for leaf in found)
        keys = [jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) for leaf in given]
        for key, one, other in zip(keys, given, found, strict=True):
            np.testing.assert_array_equal(jax.random.key_data(one) if key else one, other)


@pytest.mark.parametrize("change", [-1, 1])
def test_the_number_of_words_is_checked(change):
    tree = (jnp.zeros(3), jnp.int32(1))
    with pytest.raises(AssertionError, match="shape"):
        unpack(tree, jnp.zeros(4 + change, jnp.uint32))


def test_acting_and_hyperparameters_of_every_choice_can_be_packed():
    hyper = typed(RunHyper())
    takeover = {"boundary_source": "network", "intervention": "takeover"}
    for choices in ({}, takeover, {"boundary_source": "pid"}):
        state = init_acting(make_agent(paper_config(**choices)), hyper, make_key(3))
        for tree in (state, hyper):
            tree = jax.tree.map(jnp.asarray, tree)
            back = unpack(tree, pack(tree))
            assert _bits(jax.tree.leaves(back)) == _bits(jax.tree.leaves(tree))


def test_the_boundary_of_every_run_is_read_back():
    agent = make_agent(paper_config())
    programs = compiled_batch.make_programs(agent, 2, 1)
    acting = batch_arrays.empty_acting(agent, 3, jax.devices()[0])
    hyper = typed(RunHyper(initial_boundary=0.25))
    acting = programs.begin_acting(acting, 1, hyper, make_key(0))
    default = RunHyper().initial_boundary
    np.testing.assert_allclose(programs.boundaries(acting)[:3], [default, 0.25, default])
