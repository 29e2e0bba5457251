"""The same numbers where JAX's configuration makes 64-bit arrays, or other keys, by default."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from learners import LEARNERS
from pages import python_in, run, section
from paper_team import paper_config, paper_hyper
from toy import ToyPool

from hitl_jax import human, walker
from hitl_jax.config import Method, RunHyper, hyper_for, typed
from hitl_jax.envs import jax_pool
from hitl_jax.evaluation import host, trials
from hitl_jax.learner import frame, losses, replay
from hitl_jax.team import acting
from hitl_jax.team import agent as agents
from hitl_jax.team.packed_decision import act_or_begin
from hitl_jax.training import batch_arrays, device_stage
from hitl_jax.training.device_ticks import ChunkStart
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import RunSpec
from hitl_jax.types import Transition
from hitl_jax.walker import terrain
from hitl_jax.xla.threefry import make_key

_TEAMS = (
    paper_config(boundary_source="residual", matmul_precision="bfloat16"),
    paper_config(
        learner="td3",
        boundary_source="network",
        intervention="takeover",
        release="hysteresis",
        danger="predictive",
        indicator="weighted",
    ),
    paper_config(learner="ddpg", boundary_source="pid", intervention="penalty"),
)


@pytest.fixture
def wide():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def _with(name, value, function):
    before = getattr(jax.config, name)
    jax.config.update(name, value)
    try:
        return function()
    finally:
        jax.config.update(name, before)


def _wide_floats(function, *args):
    """Types of 64 bits in a program: of any number that is not whole, and of what it gives."""
    seen = set()

    def of(jaxpr):
        if id(jaxpr) in seen:
            return
        seen.add(id(jaxpr))
        for equation in jaxpr.eqns:
            yield from (var.aval for var in equation.outvars)
            for value in jax.tree.leaves(
                list(equation.params.values()),
                is_leaf=lambda one: hasattr(one, "eqns") or hasattr(one, "jaxpr"),
            ):
                inner = getattr(value, "jaxpr", value)
                if hasattr(inner, "eqns"):
                    yield from of(inner)

    closed = jax.make_jaxpr(function)(*args)
    given = [str(getattr(aval, "dtype", "")) for aval in closed.out_avals]
    inside = [str(getattr(aval, "dtype", "")) for aval in of(closed.jaxpr)]
    assert inside
    return [name for name in inside if name == "float64"] + [n for n in given if "64" in n]


def _same(one, other):
    """To the last bit, types included."""

    def data(leaf):
        key = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if key else leaf)

    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert (data(a).dtype, data(a).tobytes()) == (data(b).dtype, data(b).tobytes())


@pytest.mark.parametrize(
    ("config", "hyper"), list(zip(_TEAMS, (RunHyper(), typed(RunHyper()), RunHyper()), strict=True))
)
def test_no_program_of_a_team_has_wide_numbers(config, hyper, wide):
    agent, key = agents.make_agent(config), make_key(0)
    train = jax.eval_shape(functools.partial(agents.init, agent), key)
    state = jax.eval_shape(lambda: acting.init_acting(agent, hyper, key))
    memory = jax.eval_shape(lambda: replay.init(320, 2, agent.layout))
    params = jax.eval_shape(agents.behavior, train)
    learned = _wide_floats(lambda s, m: agents.learn(agent, hyper, s, m, 0, 8), train, memory)
    assert learned == []
    assert _wide_floats(functools.partial(agents.init, agent), key) == []
    # What a caller gives may be as wide as it likes.
    seen = jnp.zeros(24)
    assert seen.dtype == jnp.float64
    act = functools.partial(act_or_begin, agent, hyper)
    assert set(_wide_floats(lambda p, s: act(p, s, seen, True), params, state)) <= {"float64"}
    assert _wide_floats(lambda p, s, o: act(p, s, o, True), params, state, np.float32(seen)) == []


@pytest.mark.slow
def test_no_program_with_a_walker_has_wide_numbers(wide):
    agent = agents.make_agent(paper_config())
    for hardcore in (False, True):
        reset = functools.partial(walker.reset, hardcore=hardcore)
        assert _wide_floats(reset, make_key(0)) == []
        one = jax.eval_shape(reset, make_key(0))[0]
        assert _wide_floats(walker.step, one, jnp.zeros(4, jnp.float32)) == []
        told = jax.eval_shape(walker.step, one, jnp.zeros(4))[1]
        assert told.observation.dtype == told.reward.dtype == jnp.float32
    walkers = jax.eval_shape(lambda: jax_pool.new_walkers(jnp.zeros(16, jnp.uint32), False))
    some = jax.eval_shape(lambda: batch_arrays.empty_acting(agent, 16, jax.devices()[0]))
    params = jax.eval_shape(
        lambda: jax.vmap(lambda key: agents.behavior(agents.init(agent, key)))(
            jax.random.split(make_key(0), 16)
        )
    )
    left, yes = np.ones(16, np.int32), np.ones(16, bool)
    begin = ChunkStart(yes, yes, left, np.zeros((16, 24), np.float32))
    rest = params, [yes], begin, np.zeros((16, 5), np.uint32), left
    play = functools.partial(device_stage._play, agent, 4)
    assert _wide_floats(play, some.state, some.hyper, walkers, rest) == []


def _played():
    specs = [
        RunSpec(m, 3, hyper_for(m, paper_hyper(warmup_steps=32, initial_boundary=0.5)), 10, (2,))
        for m in (Method.SRL, Method.HITL_AC)
    ]
    agent = agents.make_agent(small.AGENT)
    rollout = Rollout(agent, specs, ToyPool(4), small.LOOP)
    runs = sorted((run for done in rollout for run in done), key=lambda run: run.run.spec.method)
    examiner = host.HostExaminer(agent, ToyPool(4))
    tests = trials.evaluate_runs(examiner, runs, lambda _: ("autonomous", "assisted"))
    assert all(run.run.updates > 0 for run in runs)
    return [(run.train, run.boundary) for run in runs], repr([r.run.episodes for r in runs]), tests


@pytest.mark.slow
def test_runs_and_their_tests_are_the_same():
    trained, episodes, tests = _played()
    wide_trained, wide_episodes, wide_tests = _with("jax_enable_x64", True, _played)
    _same(trained, wide_trained)
    assert episodes == wide_episodes
    assert repr(tests) == repr(wide_tests)


@pytest.mark.slow
@pytest.mark.parametrize("learner", LEARNERS)
def test_an_update_of_a_callers_own_arrays_is_the_same(learner):
    agent = agents.make_agent(paper_config(learner=learner, hidden_sizes=(32, 32)))
    rng = np.random.default_rng(0)
    shapes = ((8, 24), (8, 4), (8,), (8,), (8, 24), (8, 4))
    numbers = [rng.normal(size=shape).astype(np.float32).tolist() for shape in shapes]

    def updated():
        *columns, noise = map(jnp.array, numbers)
        state = agents.init(agent, make_key(1))
        # A caller's numbers are Python's; a power is taken of two of them, and a root.
        hyper = hyper_for(Method.HITL_AC, paper_hyper(target_step_size=0.003, gamma=0.97))
        return agents.update(agent, hyper, state, Transition(*columns), noise)

    _same(updated(), _with("jax_enable_x64", True, updated))


@pytest.mark.parametrize("part", [human.mistaken, human.lapsing])
def test_a_human_errs_at_the_same_steps(part):
    params = human.HumanParams(mistake_rate=0.5, lapse_rate=0.5)

    def judged():
        judge = functools.partial(part().judge, (), params, None, jnp.array(True))
        return [bool(judge(make_key(seed))[1]) for seed in range(20)]

    told = judged()
    assert {True, False} == set(told)
    assert _with("jax_enable_x64", True, judged) == told


@pytest.mark.parametrize("rough", [False, True])
def test_terrain_is_the_same(rough):
    def drawn():
        return terrain.draw(make_key(5), rough)

    _same(drawn(), _with("jax_enable_x64", True, drawn))


def test_small_functions_keep_their_types(wide):
    f = functools.partial(jnp.ones, dtype=jnp.float32)
    given = losses.target_quantiles(f(4), f(4), f((2, 4, 3)), num_dropped=1)
    assert {leaf.dtype for leaf in given} == {jnp.dtype("float32")}
    assert human.outcome_dangerous(jnp.array([False, True]), 2).tolist() == [True, True]
    layout = frame.Layout(1, 1)
    memory = replay.add(replay.init(8, 1, layout), jnp.ones((1, 8, layout.width)))
    drawn = replay.draw(memory, layout, 0, make_key(0), 4, 2, 0.9)
    assert {leaf.dtype.itemsize for leaf in jax.tree.leaves((memory, drawn))} == {4}
    state = acting.init_acting(agents.make_agent(paper_config()), RunHyper(), make_key(0))
    assert not [leaf.dtype for leaf in jax.tree.leaves(state) if "64" in str(leaf.dtype)]
    assert trials.terrain_seeds(_spec(), range(3)).dtype == np.uint32


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("jax_enable_x64", True),
        ("jax_default_prng_impl", "rbg"),
        ("jax_default_matmul_precision", "bfloat16"),
    ],
)
def test_keys_and_first_parameters_are_the_same(name, value):
    agent = agents.make_agent(paper_config(hidden_sizes=(8,)))

    def begun():
        keys = batch_arrays.run_keys(2**32 - 1, 1)
        return [jax.random.key_data(key) for key in keys], agents.init(agent, keys[0])

    _same(begun(), _with(name, value, begun))


@pytest.mark.slow
@pytest.mark.parametrize(
    "heading",
    ["A human of your own", "An environment of your own", "The update functions alone"],
)
def test_the_programs_of_the_pages_run(heading, wide, tmp_path):
    run("\n".join(python_in(section("docs/library.md", heading))), tmp_path)


def _spec():
    return RunSpec(Method.SRL, 0, hyper_for(Method.SRL, paper_hyper()), 1)
