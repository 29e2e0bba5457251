import dataclasses
import re

import jax
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper
from toy import ToyPool

from hitl_jax.benchmarks.timing import memory_mb
from hitl_jax.config import Method, hyper_for
from hitl_jax.envs import Command
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import evaluate_runs
from hitl_jax.team.agent import behavior, make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec, episode_seed, num_slots
from hitl_jax.xla.devices import learning_devices

_CONFIG = paper_config(
    learner="td3", hidden_sizes=(16, 16), batch_size=16, n_step=2, tested_actor="average"
)
_HYPER = paper_hyper(warmup_steps=64, initial_boundary=0.5, delta_minus=0.01, delta_plus=0.01)
_LOOP = LoopConfig(capacity=128, chunk=8)  # so small that a run fills it several times


def _spec(method, seed, **changes):
    hyper = hyper_for(method, _HYPER.replace(**changes))
    return RunSpec(method, seed, hyper, episodes=12, snapshots=(3, 7))


def _play(specs, slots, config=_CONFIG, loop=_LOOP):
    """Finished runs by (method, seed)."""
    rollout = Rollout(make_agent(config), specs, ToyPool(slots), loop)
    finished = [run for done in rollout for run in done]
    assert len(finished) == len(specs)
    return {(done.run.spec.method, done.run.spec.seed): done for done in finished}


def _assert_same(one, other):
    """To the last bit: company and place change nothing, not even rounding."""
    assert one.run.env_steps == other.run.env_steps
    assert one.run.updates == other.run.updates > 0
    # As text, since NaN differs from itself.
    assert repr(one.run.episodes) == repr(other.run.episodes)
    jax.tree.map(np.testing.assert_array_equal, one.train, other.train)
    assert one.boundary == other.boundary


@pytest.mark.slow
def test_snapshots_that_fall_due_in_one_chunk_are_all_kept():
    spec = dataclasses.replace(_spec(Method.HITL_AC, 1), snapshots=(1, 2, 3, 4))
    loop = LoopConfig(capacity=512, chunk=128, updates_per_step=0.0)
    [run] = _play([spec], slots=2, loop=loop).values()
    assert [snapshot.episode for snapshot in run.run.snapshots] == [1, 2, 3, 4]


@pytest.mark.slow
def test_nothing_is_compiled_again():
    compiled = []

    def listen(event, *_, **__):
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    specs = [_spec(method, seed) for seed in range(3) for method in Method]
    slots, num_devices = 4, len(learning_devices())
    rollout = Rollout(make_agent(_CONFIG), specs, ToyPool(slots), _LOOP)
    counts, finished, devices = [], 0, set()
    known = None
    for done in rollout:
        finished += len(done)
        counts.append(len(compiled))
        devices |= {run.run.slot * num_devices // slots for run in done}
        if known is None and len(devices) == num_devices:
            known = len(counts) - 1
    assert finished == len(specs)
    assert counts[0] > 0
    # The first run to finish on a device brings its last program (taking the rows out). After that
    # runs end, others are seated, the number that learns changes, and nothing is compiled.
    assert known is not None
    assert known < len(counts) - 1
    assert counts[known] == counts[-1]


@pytest.mark.slow
def test_memory_is_flat():
    """Arrays of JAX to the byte; of the process, what the episodes' rows and the allocator take."""
    specs = [
        dataclasses.replace(_spec(method, seed), episodes=10**6)
        for seed in range(2)
        for method in Method
    ]
    playing = Rollout(make_agent(_CONFIG), specs, ToyPool(6), _LOOP)
    rollout = iter(playing)
    sizes = []
    for chunks in (50, 300, 300):  # The learners are first sampled in the second.
        for _ in range(chunks):
            next(rollout)
        arrays = sum(array.nbytes for array in jax.live_arrays())
        sizes.append((arrays, len(jax.live_arrays()), memory_mb()))
    *arrays, before = sizes[1]
    *arrays_after, after = sizes[2]
    assert arrays_after == arrays
    assert after - before < 5
    assert [len(run.diagnostics) for run in playing.runs()] == [2] * 6


def test_a_finished_run_takes_no_more_steps():
    pool = ToyPool(4)
    specs = [_spec(Method.SRL, 0), _spec(Method.HITL_AC, 0)]
    rollout = Rollout(make_agent(_CONFIG), specs, pool, _LOOP)
    finished = [run for done in rollout for run in done]
    assert pool.steps == sum(done.run.env_steps for done in finished)


@pytest.mark.parametrize("terminates", [True, False])
def test_a_human_reset_ends_the_episode_and_pays_the_feedback(terminates):
    config = dataclasses.replace(_CONFIG, human_reset_terminates=terminates)
    done = _play([_spec(Method.HITL_FIX, 0)], slots=4, config=config)[Method.HITL_FIX, 0]
    reset = [row for row in done.run.episodes if row["end"] == "human-reset"]
    assert reset
    for row in reset:
        assert (row["interventions"], row["human_steps"]) == (1, 0)
        np.testing.assert_allclose(row["shaped_return"], row["return"] - 20.0, rtol=1e-5)


def test_reset_seeds_come_from_method_seed_and_episode():
    assert episode_seed(Method.SRL, 3, 0) == episode_seed("srl", 3, 0)
    words = [(m, s, e) for m in Method for s in range(10) for e in range(100)]
    assert len({episode_seed(*word) for word in words}) == len(words)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"updates_per_step": -1.0}, "updates_per_step -1.0: must be at least 0"),
        ({"capacity": 3}, "capacity 3: must be at least 32"),
    ],
)
def test_bad_loop(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        LoopConfig(**change)


def test_updates_of_a_chunk_must_be_whole():
    with pytest.raises(ValueError, match=r"updates_per_step 0\.3"):
        LoopConfig(updates_per_step=0.3).num_updates(2)


def test_there_are_few_numbers_of_slots():
    """Powers of two, no more than asked for, a multiple of the two devices that learn."""
    assert [num_slots(runs, 32) for runs in (1, 2, 3, 10, 30, 40)] == [4, 4, 4, 16, 32, 32]
    assert num_slots(30, 30) == 30
    assert num_slots(5, 1) == 4


@pytest.fixture(scope="module")
def together(compiled_fully):
    """Runs side by side; who asks for them is compiled fully, as all tests from here on."""
    specs = [_spec(method, seed) for seed in range(2) for method in Method]
    return _play(specs, slots=6)


def test_a_run_equals_the_same_run_alone(together):
    for method in Method:
        alone = _play([_spec(method, 1)], slots=2)
        _assert_same(alone[method, 1], together[method, 1])


@pytest.mark.slow
def test_order_queue_and_neighbours_do_not_matter(together):
    # Fewer slots than runs, another order, and neighbours of other hyperparameters.
    specs = [_spec(method, seed) for method in reversed(Method) for seed in (1, 0)]
    specs.insert(1, _spec(Method.SRL, 7, exploration_noise=0.5))
    queued = _play(specs, slots=4)
    for key, run in together.items():
        _assert_same(queued[key], run)


def test_each_run_has_its_own_weight_of_the_reward(together):
    """Beside one of another weight, of the same seed; the feedback is given at each step."""
    specs = [
        _spec(Method.HITL_FIX, seed, reward_weight=weight) for seed, weight in ((0, 1), (1, 0))
    ]
    played = _play(specs, slots=2)
    _assert_same(played[Method.HITL_FIX, 0], together[Method.HITL_FIX, 0])
    rows = played[Method.HITL_FIX, 1].run.episodes
    assert any(row["return"] for row in rows)
    assert any(row["shaped_return"] for row in rows)
    for row in rows:
        assert row["shaped_return"] == pytest.approx(_HYPER.feedback * row["interventions"])


def test_a_snapshot_is_what_a_shorter_run_ends_with(together):
    kept = together[Method.HITL_AC, 1].run.snapshots
    assert [snapshot.episode for snapshot in kept] == [3, 7]
    spec = dataclasses.replace(_spec(Method.HITL_AC, 1), snapshots=())
    short = [dataclasses.replace(spec, episodes=n) for n in (3, 7)]
    rollout = Rollout(make_agent(_CONFIG), short, ToyPool(2), _LOOP)
    ended = [run for done in rollout for run in done]
    for snapshot, run in zip(kept, ended, strict=True):
        jax.tree.map(np.testing.assert_array_equal, snapshot.behavior, behavior(run.kept))
        assert snapshot.boundary == run.boundary


def test_the_average_is_kept_and_the_last_acts(together):
    for run in together.values():
        learner, average = run.train.learner, run.train.average.params
        assert run.kept.learner.actor is average
        assert run.kept.learner.critic is learner.critic
        pairs = zip(*map(jax.tree.leaves, (average, learner.actor)), strict=True)
        assert any((average != last).any() for average, last in pairs)


def test_methods_and_seeds_differ(together):
    returns = {key: [row["return"] for row in run.run.episodes] for key, run in together.items()}
    assert len({tuple(values) for values in returns.values()}) == len(returns)


class BrokenPool(ToyPool):
    """Gives walker 0, once, a number that is none."""

    def __init__(self, num_walkers, field, tick):
        super().__init__(num_walkers)
        self._field, self._left = field, tick

    def step(self, command, action, seed):
        assert np.isfinite(action[command == Command.STEP]).all()
        answer = super().step(command, action, seed)
        self._left -= 1
        if self._left == 0:
            getattr(answer, self._field)[0] = np.nan
        return answer


def _play_with_one_lost(specs, pool, together):
    """The run that diverged, when the others are as they are without it."""
    rollout = Rollout(make_agent(_CONFIG), specs, pool, _LOOP)
    finished = {(run.run.spec.method, run.run.spec.seed): run for done in rollout for run in done}
    [lost] = [run for run in finished.values() if run.run.diverged]
    assert len(finished) == len(together)
    for name, run in finished.items():
        if run is not lost:
            _assert_same(run, together[name])
    return lost


def _assert_falls(rows):
    assert {(row["return"], row["length"], row["end"]) for row in rows} == {(-100.0, 1, "fall")}


@pytest.mark.slow
def test_parameters_that_are_not_finite_end_a_run(together):
    sick = _spec(Method.SRL, 7, actor_learning_rate=1e30, critic_learning_rate=1e30)
    specs = [sick, *(_spec(method, seed) for method, seed in list(together)[1:])]
    # In four slots: its own goes to another run, which is well.
    lost = _play_with_one_lost(specs, ToyPool(4), together)
    assert lost.run.spec is sick
    quantity, env_steps, episodes = lost.run.diverged
    assert quantity == "parameters"
    assert env_steps > _HYPER.warmup_steps
    assert len(lost.run.all_episodes()) == sick.episodes > len(lost.run.episodes) == episodes
    _assert_falls(lost.run.all_episodes()[episodes:])
    # So do its tests, and those of its snapshots from there on.
    evaluator = HostExaminer(make_agent(_CONFIG), ToyPool(4))
    [(at_end, on_the_way)] = evaluate_runs(evaluator, [lost], lambda _: ("autonomous", "assisted"))
    assert len(at_end) == 8
    _assert_falls(at_end)
    for row in on_the_way:
        assert (row["length"] == 1) == (row["trained"] > episodes)


@pytest.mark.parametrize("field", ["observation", "reward"])
def test_a_plant_that_gives_no_number_ends_a_run(field, together):
    specs = [_spec(method, seed) for method, seed in together]
    lost = _play_with_one_lost(specs, BrokenPool(6, field, 100), together)
    assert lost.run.spec is specs[0]
    assert lost.run.diverged.quantity == field
    rows = lost.run.all_episodes()
    assert repr(rows[:2]) == repr(together[next(iter(together))].run.episodes[:2])
    _assert_falls(rows[lost.run.diverged.episodes :])
