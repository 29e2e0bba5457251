"""What a human of one's own may remember: plain numbers, narrow types, and what is refused."""

import functools

import compiled
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper
from toy import ToyPool

from hitl_jax import human
from hitl_jax.config import Method, RunHyper, hyper_for
from hitl_jax.errors import InvalidValue
from hitl_jax.human import actions, caller_state
from hitl_jax.team import acting
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec
from hitl_jax.xla.pytree_words import pack, unpack
from hitl_jax.xla.threefry import make_key

_CONFIG = paper_config(learner="td3", hidden_sizes=(8,), batch_size=8)

_NARROW = {
    "int8": [-128, -1, 0, 127],
    "uint8": [0, 1, 128, 255],
    "int16": [-(2**15), -1, 2**15 - 1],
    "uint16": [0, 2**16 - 1],
    "float16": [-0.0, 1.5, np.inf, np.nan],
    "bfloat16": [-0.0, 1.5, -np.inf, np.nan],
    "uint32": [0, 2**32 - 1],
}


@pytest.mark.parametrize("dtype", _NARROW)
def test_narrow_leaves_lose_no_bit(dtype):
    leaf = jnp.array(_NARROW[dtype], dtype)
    tree = {"a": leaf, "b": jnp.float32(1.5), "c": leaf.reshape(1, -1), "d": jnp.zeros((0,), dtype)}
    words = jax.jit(pack)(tree)
    assert (words.dtype, words.size) == (jnp.uint32, 2 * leaf.size + 1)
    back = jax.jit(unpack)(tree, words)
    for one, other in zip(jax.tree.leaves(tree), jax.tree.leaves(back), strict=True):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes()


@pytest.mark.parametrize("dtype", ["complex64", "int4"])
def test_what_cannot_be_packed_is_named(dtype):
    with pytest.raises(ValueError, match=f"a leaf of type {dtype}: must have 8, 16 or 32 bits"):
        pack({"a": jnp.zeros(2, dtype)})


@pytest.mark.parametrize(
    ("state", "dtype"),
    [
        (0, "int32"),
        (0.5, "float32"),
        (True, "bool"),
        (np.float64(0.5), "float32"),
        (np.int64(-3), "int32"),
        (np.uint64(3), "uint32"),
        (np.zeros(3), "float32"),
        (np.int8(3), "int8"),
        (jnp.bfloat16(0.5), "bfloat16"),
        (np.float16(0.5), "float16"),
    ],
)
def test_a_state_begins_as_an_array(state, dtype):
    array = caller_state.begun("the human", state)
    assert array.dtype == jnp.dtype(dtype)
    assert not array.weak_type
    assert caller_state.begun("the human", {"a": (state, None)})["a"][1] is None


def test_a_key_can_be_remembered():
    key = make_key(3)
    assert caller_state.begun("the human", key) is key
    assert caller_state.kept("the human", key, make_key(4)) is key


@pytest.mark.parametrize("state", ["calm", 1j, 2**40, np.int64(2**31), object(), -(2**40)])
def test_what_cannot_be_remembered_is_named(state):
    with pytest.raises(ValueError, match=r"state of the human holds .*: must be arrays") as caught:
        caller_state.begun("the human", [state])
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (0, 0.5),
        (np.int8(0), jnp.int32(0)),
        (0, jnp.zeros(2)),
        (False, 1),
        (jnp.bfloat16(0), jnp.float32(0)),
        (0, (0,)),
        ({"a": 0}, {"b": 0}),
        (0, None),
    ],
)
def test_a_state_that_becomes_another_is_refused(before, after):
    with pytest.raises(ValueError, match="state of the human: ") as caught:
        caller_state.kept("the human", after, caller_state.begun("the human", before))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("before", "after"), [(0.0, 1), (0, True), (np.int8(0), 5), (jnp.bfloat16(0), 0.5)]
)
def test_a_state_keeps_its_type(before, after):
    begun = caller_state.begun("the human", before)
    kept = caller_state.kept("the human", after, begun)
    assert (kept.dtype, float(kept)) == (begun.dtype, float(after))


def _counting(start, step):
    """Sees danger at every third step, by a state of its own."""

    def judge(state, params, observation, dangerous, key):
        return state + step, state % 3 == 0

    return human.HumanPart(
        init=lambda: start,
        begin_episode=lambda state: state,
        judge=judge,
        notify=lambda state, *_: state,
    )


def _acted(start, step, steps=8):
    """Judgements, by compiled calls of which none but the first compiles."""
    agent = make_agent(_CONFIG, judge=_counting(start, step))
    hyper, seen = RunHyper(), np.zeros(24, np.float32)
    params = jax.tree.map(
        lambda leaf: np.zeros(leaf.shape, leaf.dtype), jax.eval_shape(lambda: _params(agent))
    )
    act = jax.jit(functools.partial(acting.act, agent, hyper))
    state, told = acting.init_acting(agent, hyper, make_key(0)), []
    for _ in range(steps):
        state, decision = act(params, state, seen)
        told.append(bool(decision.dangerous))
    assert act._cache_size() == 1
    return told


def _params(agent):
    from hitl_jax.team import agent as agents

    return agents.behavior(compiled.init(agent, make_key(0)))


@pytest.mark.parametrize(
    ("start", "step"),
    [
        (0, 1),
        (0.0, 1.0),
        (np.int8(0), 1),
        (jnp.bfloat16(0), 1),
        (np.zeros(()), 1),
        (np.int64(0), 1),
    ],
)
def test_a_human_of_plain_numbers_acts(start, step):
    assert _acted(start, step) == [True, False, False] * 2 + [True, False]


@pytest.mark.slow
def test_runs_with_such_a_human_are_those_of_one_with_arrays():
    def played(start):
        agent = make_agent(_CONFIG, judge=_counting(start, 1))
        hyper = hyper_for(Method.HITL_AC, paper_hyper(warmup_steps=10**6, initial_boundary=0.1))
        spec = RunSpec(Method.HITL_AC, 0, hyper, 3)
        rollout = Rollout(agent, [spec], ToyPool(2), LoopConfig(capacity=64, chunk=8))
        [run] = [run for done in rollout for run in done]
        return repr(run.run.episodes)

    told = played(jnp.int32(0))
    assert "human-reset" in told
    assert played(0) == told
    assert played(np.int16(0)) == told


def test_a_source_of_actions_may_count_in_plain_numbers():
    def act(state, observation, key):
        return state + 1, jnp.full(4, 0.25)

    source = actions.ActionSource(lambda: 0, lambda state: 0, act)
    agent = make_agent(_CONFIG, source=source)
    state = acting.init_acting(agent, RunHyper(), make_key(0))
    state, _ = acting.act(agent, RunHyper(), _params(agent), state, np.zeros(24, np.float32))
    assert (int(state.source), state.source.dtype) == (1, jnp.int32)
    assert int(acting.begin_episode(agent, state).source) == 0


def test_an_agent_whose_human_changes_its_type_is_refused_at_once():
    with pytest.raises(InvalidValue, match=r"^judge .*: a leaf was int32\[\] and is float32\[\]"):
        make_agent(_CONFIG, judge=_counting(0, 0.5))
