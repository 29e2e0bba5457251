import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.config import Method, hyper_for
from hitl_jax.learner import replay
from hitl_jax.team import agent as agents
from hitl_jax.training import batch_arrays, compiled_batch, learn_batch
from hitl_jax.xla import pytree_words
from hitl_jax.xla.dense_product import MATMUL_PRECISIONS
from hitl_jax.xla.devices import cpu_device
from hitl_jax.xla.pytree_words import unpack
from hitl_jax.xla.threefry import make_key

pytestmark = pytest.mark.slow

_AGENT, _ROUNDED = (
    agents.make_agent(
        paper_config(
            learner="td3",
            hidden_sizes=(16, 16),
            batch_size=16,
            n_step=2,
            matmul_precision=precision,
        )
    )
    for precision in MATMUL_PRECISIONS
)
_WITH_A_TRAINED_HUMAN = agents.make_agent(
    dataclasses.replace(
        _AGENT.config, danger="experienced", human_actions="trained", intervention="takeover"
    )
)
_UPDATES = 4


def _hyper(index):
    """Runs of different methods and hyperparameters, as one program takes them."""
    method = list(Method)[index % 3]
    hyper = paper_hyper(actor_learning_rate=1e-3 / (1 + index), gamma=0.9 + 0.01 * index)
    return jax.tree.map(np.asarray, hyper_for(method, hyper))


def _frames(runs, first=0):
    layout = _AGENT.layout
    frames = np.zeros((len(runs), 32, layout.width), np.float32)
    for row, run in enumerate(runs):
        rng = np.random.default_rng((run, first))
        frames[row] = rng.normal(size=frames.shape[1:])
        frames[row, :, layout.terminated : layout.final + 1] = 0
    return frames


def _learn(runs, tile, skip=(), device=0, agent=_AGENT):
    """Training states of runs (any order, any number) after two calls of the learner."""
    seats = batch_arrays.empty_learner(agent, len(runs), 64, cpu_device(f"learner {device}"))
    programs = compiled_batch.make_programs(agent, _UPDATES, tile)
    for slot, run in enumerate(runs):
        train, _ = jax.device_get(programs.begin(make_key(run)))
        seats = programs.begin_learning(seats, slot, _hyper(run), train)
    listed = [slot for slot, run in enumerate(runs) if run not in skip]
    slots = np.zeros(len(runs), np.int32)
    slots[: len(listed)] = listed
    for call in range(2):
        seats, _ = programs.learn(seats, _frames(runs, call), slots, np.int32(len(listed)))
    like = batch_arrays.some_train(agent)
    after = {run: unpack(like, seats.train[slot]) for slot, run in enumerate(runs)}
    return {run: jax.device_get((train.learner, train.boundary)) for run, train in after.items()}


def _forget_programs():
    compiled_batch.make_programs.cache_clear()
    jax.clear_caches()


def _same(one, other):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-4, atol=1e-6), one, other)


@pytest.fixture(scope="module")
def plainly():
    """The same learning without vmap or loop: one run after the other."""
    learn = jax.jit(
        lambda state, memory, hyper: agents.learn(
            _AGENT, hyper, state, memory, jnp.int32(0), _UPDATES
        )
    )
    after = {}
    for run in range(6):
        memory = replay.init(64, 1, _AGENT.layout)
        state = agents.init(_AGENT, jax.random.key(run))
        for call in range(2):
            memory = replay.add(memory, jnp.asarray(_frames([run], call)))
            state = learn(state, memory, _hyper(run))
        after[run] = jax.device_get((state.learner, state.boundary))
    return after


@pytest.mark.parametrize("tile", [1, 2])
def test_a_run_in_the_batch_equals_the_run_alone(plainly, tile):
    for run, learner in _learn(list(range(6)), tile).items():
        _same(learner, plainly[run])


def test_a_run_of_several_pieces_equals_the_run_alone(plainly, monkeypatch):
    """As networks of the default width have them, whose large leaves are read and written apart."""
    _forget_programs()
    monkeypatch.setattr(pytree_words, "_LARGE", 64)
    assert len(pytree_words.piece_sizes(batch_arrays.some_train(_AGENT))) > 10
    for run, learner in _learn(list(range(3)), 1).items():
        _same(learner, plainly[run])
    _forget_programs()


def test_order_and_devices_do_not_matter(plainly):
    for learned in (_learn([3, 0, 5, 1, 4, 2], 3), _learn([2, 4, 1], 1, device=1)):
        for run, learner in learned.items():
            _same(learner, plainly[run])


def test_a_run_that_is_not_listed_does_not_change(plainly):
    learned = _learn(list(range(6)), 2, skip=(1, 4))
    for run in (0, 2, 3, 5):
        _same(learned[run], plainly[run])
    for run in (1, 4):
        fresh = agents.init(_AGENT, jax.random.key(run))
        _same(learned[run], jax.device_get((fresh.learner, fresh.boundary)))


def test_seeds_are_words_of_32_bits():
    many = {
        tuple(jax.random.key_data(batch_arrays.run_keys(s, 1)[0]).tolist())
        for s in (0, 2**31, 2**32 - 1)
    }
    assert len(many) == 3


def test_keys_come_from_method_and_seed():
    keys = [batch_arrays.run_keys(seed, method) for seed in range(3) for method in range(3)]
    data = {tuple(jax.random.key_data(key).tolist()) for three in keys for key in three}
    assert len(data) == 27


@pytest.mark.parametrize("tile", [1, 2])
def test_seats_are_updated_in_place(tile):
    seats = batch_arrays.empty_learner(_AGENT, 6, 64, cpu_device("learner 0"))
    programs = compiled_batch.make_programs(_AGENT, _UPDATES, tile)
    frames = _frames(range(6))
    pointers = []
    for _ in range(2):
        seats, _ = programs.learn(seats, frames, np.arange(6, dtype=np.int32), np.int32(6))
        arrays = seats.train, seats.memory.seen, seats.memory.outcome
        pointers.append([array.unsafe_buffer_pointer() for array in arrays])
    assert pointers[0] == pointers[1]


def test_a_run_is_given_back_without_a_copy_of_all():
    """Of a network whose leaves are written apart: XLA copies where it cannot tell the order."""
    agent = agents.make_agent(paper_config(learner="td3", layer_norm=False, batch_size=8))
    seats = jax.eval_shape(lambda: batch_arrays.empty_learner(agent, 6, 64, jax.devices()[0]))
    learn = functools.partial(learn_batch.learn_all, agent, _UPDATES, 1)
    frames = jax.ShapeDtypeStruct((6, 32, agent.layout.width), jnp.float32)
    slots = jax.ShapeDtypeStruct((6,), jnp.int32)
    count = jax.ShapeDtypeStruct((), jnp.int32)
    given = ((seats.train, seats.memory), seats.hyper, frames, slots, count)
    program = jax.jit(learn, donate_argnums=0).lower(*given).compile().as_text()
    words = f"u32[{seats.train.shape[0]},{seats.train.shape[1]}]"
    assert f"{words}{{1,0}} dynamic-update-slice(" in program
    assert f"{words}{{1,0}} copy(" not in program


@pytest.mark.usefixtures("compiled_fully")
@pytest.mark.parametrize(("tile", "agent"), [(1, _AGENT), (3, _ROUNDED)])
def test_neighbours_do_not_change_a_bit(tile, agent):
    """Of two slots or more: see `num_slots`."""
    few = _learn([4, 1], tile, agent=agent)
    many = _learn([5, 4, 3, 2, 1, 0], tile, agent=agent)
    for run, train in few.items():
        jax.tree.map(np.testing.assert_array_equal, train, many[run])


def _act(runs, agent):
    """What runs that act side by side decide and remember after each of five ticks."""
    programs = compiled_batch.make_programs(agent, _UPDATES, 1)
    keys = [batch_arrays.run_keys(run, 0) for run in runs]
    acting = batch_arrays.empty_acting(agent, len(runs), cpu_device("acting", own_thread=False))
    for slot, (run, (_, key, _)) in enumerate(zip(runs, keys, strict=True)):
        key = jax.device_put(key, acting.state.device)
        acting = programs.begin_acting(acting, slot, agent.with_extra(_hyper(run)), key)
    rows = np.stack([programs.begin(key)[1] for key, *_ in keys])
    behavior = programs.unpack_behavior([rows], acting.hyper)
    told = {run: [] for run in runs}
    for tick in range(5):
        seen = np.zeros((len(acting.state), 24), np.float32)
        for slot, run in enumerate(runs):
            seen[slot] = np.random.default_rng((run, tick)).normal(size=24)
        acting, decided = programs.act(acting, behavior, seen, np.ones(len(seen), bool))
        for slot, run in enumerate(runs):
            told[run] += [np.asarray(acting.state)[slot], np.asarray(decided)[slot]]
    return told


@pytest.mark.usefixtures("compiled_fully")
@pytest.mark.parametrize("agent", [_AGENT, _WITH_A_TRAINED_HUMAN], ids=["plain", "trained human"])
def test_who_acts_beside_a_run_does_not_change_a_bit(agent):
    """Nor how many do, nor its place among them."""
    many = _act(range(50), agent)
    for runs in ([3], [3, 4, 7], range(16), range(17), range(33), range(49, -1, -1)):
        for run, told in _act(runs, agent).items():
            jax.tree.map(np.testing.assert_array_equal, told, many[run])
