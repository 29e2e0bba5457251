"""Numbers that are not finite: what is masked is not used, and what is not stops where it comes."""

import dataclasses

import compiled
import device_toy
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from device_toy import CONFIG, HYPER, LOOP
from toy import ToyPool

from hitl_jax import arbiter, boundary
from hitl_jax.config import Method, hyper_for
from hitl_jax.envs import Command
from hitl_jax.envs.jax_pool import JaxPool
from hitl_jax.evaluation.device import DeviceExaminer
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import evaluate_runs
from hitl_jax.learner import frame, losses, replay
from hitl_jax.results.episode_measures import NOT_FINITE, num_lost
from hitl_jax.team import agent as agents
from hitl_jax.training import host_stage, rollout
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import FinishedRun, Run, RunSpec
from hitl_jax.types import BoundaryTransition

_BAD = [jnp.nan, jnp.inf, -jnp.inf]

# ------------------------------------------------------------------------------------ equations


@pytest.mark.parametrize("bad", _BAD)
def test_a_masked_value_is_not_in_a_target(bad):
    reward, discount = jnp.array([1.0, 1.0]), jnp.array([0.0, 0.5])
    target = losses.target_q(reward, discount, jnp.array([[bad, 4.0], [2.0, 6.0]]))
    np.testing.assert_array_equal(target, [1.0, 3.0])
    # Where it is not masked it shows.
    assert not np.isfinite(losses.target_q(reward, discount, jnp.array([[2.0, bad]] * 2)))[1]


@pytest.mark.parametrize("bad", _BAD)
def test_masked_quantiles_are_not_in_a_target(bad):
    reward, discount = jnp.array([1.0, 1.0]), jnp.array([0.0, 0.5])
    quantiles = jnp.array([[[bad, bad], [2.0, 8.0]]])
    target = losses.target_quantiles(reward, discount, quantiles, num_dropped=1)
    np.testing.assert_array_equal((target.value * target.weight).sum(0), [1.0, 2.0])


def test_a_dropped_quantile_is_not_in_a_loss():
    quantiles = jnp.array([[[1.0, jnp.inf, 2.0]]])
    target = losses.target_quantiles(jnp.ones(1), jnp.ones(1), quantiles, num_dropped=1)
    np.testing.assert_array_equal((target.value * target.weight).sum(0), [2.5])


@pytest.mark.parametrize("bad", _BAD)
def test_a_masked_value_is_not_in_the_boundarys_loss(bad):
    def apply(scale, observation, tau):
        return scale * observation[:, 0] * tau

    one = jnp.ones((1, 1))
    sample = BoundaryTransition(one, one[0], one[0], jnp.zeros(1), bad * one, bad * one[0])
    loss, slope = jax.value_and_grad(
        lambda scale: boundary.boundary_critic_loss(scale, apply, sample)[0]
    )(3.0)
    assert (float(loss), float(slope)) == (4.0, 4.0)  # (3 - 1)², 2 (3 - 1)


@pytest.mark.parametrize("bad", _BAD)
def test_what_follows_an_episode_is_not_in_its_return(bad):
    layout = frame.Layout(1, 1)
    frames = np.zeros((1, 6, layout.width), np.float32)
    frames[0, :, layout.reward] = [1.0, 2.0, bad, bad, bad, bad]
    frames[0, 1, layout.terminated] = 1.0
    memory = replay.add(replay.init(6, 1, layout), jnp.asarray(frames))
    drawn = replay.draw(memory, layout, 0, jax.random.key(0), 64, 4, 0.5)
    start = np.asarray(drawn.start)
    assert set(start) == {0, 1}
    # From the first frame 1 + 0.5 · 2, from the second 2.
    np.testing.assert_array_equal(drawn.reward, 2.0)
    np.testing.assert_array_equal(drawn.discount, 0.0)


@pytest.mark.parametrize("schedule", ["step", "onset", "episode"])
@pytest.mark.parametrize("module", [np, jnp])
def test_feedback_that_is_not_given_is_not_in_a_reward(schedule, module):
    reward = module.array([1.0, -0.0], np.float32)
    never = module.zeros(2, bool)
    shaped = arbiter.shaped_reward(reward, never, np.nan, schedule, never, never, never)
    np.testing.assert_array_equal(shaped, [1.0, 0.0])
    assert np.signbit(shaped).tolist() == [False, True]


def test_an_update_whose_next_observation_is_masked_is_finite():
    agent = agents.make_agent(CONFIG)
    state = compiled.init(agent, jax.random.key(0))
    batch = agents.Transition(
        observation=jnp.ones((4, 24)),
        action=jnp.ones((4, 4)),
        reward=jnp.ones(4),
        discount=jnp.zeros(4),
        next_observation=jnp.full((4, 24), jnp.nan),
    )
    hyper = hyper_for(Method.SRL, HYPER)
    after, metrics = compiled.update(agent, hyper, state, batch, jnp.zeros((4, 4)))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((after.learner, metrics)))


# ---------------------------------------------------------------------------------- the host loop


class _Breaking(ToyPool):
    """Walker 0 gives a number that is none at a moment of its first episode."""

    def __init__(self, num_walkers, field, at, bad=np.nan):
        super().__init__(num_walkers)
        self._field, self._at, self._bad = field, at, bad
        self.done = False

    def step(self, command, action, seed):
        assert np.isfinite(action[command == Command.STEP]).all()
        answer = super().step(command, action, seed)
        ends = answer.terminated[0] or answer.truncated[0]
        moments = {
            "reset": command[0] == Command.RESET,
            "middle": command[0] == Command.STEP and self._age[0] == 3,
            "end": command[0] == Command.STEP and ends,
        }
        walker = 0
        if self._at == "idle":  # One whose run has ended, while the other goes on.
            idle = np.flatnonzero((command == Command.IDLE) & (self._age > 0))
            moments, walker = {"idle": idle.size > 0}, int(idle[0]) if idle.size else 0
        if moments[self._at] and not self.done:
            self.done = True
            getattr(answer, self._field)[walker] = self._bad
        return answer


def _specs(episodes=3):
    hyper = hyper_for(Method.SRL, HYPER)
    return [RunSpec(Method.SRL, seed, hyper, episodes) for seed in range(2)]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("field", "at"),
    [
        ("observation", "reset"),
        ("observation", "middle"),
        ("observation", "end"),
        ("reward", "middle"),
        ("reward", "end"),
    ],
)
def test_the_host_ends_a_run_at_the_tick_that_brought_it(field, at, bad):
    pool = _Breaking(4, field, at, bad)
    playing = Rollout(agents.make_agent(CONFIG), _specs(), pool, LOOP)
    finished = {run.run.spec.seed: run for done in playing for run in done}
    assert pool.done
    [seed] = [seed for seed, run in finished.items() if run.run.slot == 0]
    lost = finished[seed].run.diverged
    assert (lost.quantity, lost.episodes) == (field, 0)
    # The steps before that one.
    steps = {"reset": 0, "middle": 2}.get(at, lost.env_steps)
    assert lost.env_steps == steps
    assert (at == "end") == (lost.env_steps > 2)
    assert finished[1 - seed].run.diverged is None
    for run in finished.values():
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(run.train))


def test_what_an_idle_walker_shows_ends_no_run():
    pool = _Breaking(4, "observation", "idle")
    playing = Rollout(agents.make_agent(CONFIG), _specs(2), pool, LOOP)
    finished = [run for done in playing for run in done]
    assert pool.done
    assert len(finished) == 2
    assert not any(run.run.diverged for run in finished)


# ------------------------------------------------------------------------- the device, and tests


def _broken(monkeypatch, field, at):
    """Toys on the device whose observation or reward is no number at a moment of an episode."""
    before = device_toy._tick

    def tick(broken_from, toys, command, action, seed):
        toys, step = before(broken_from, toys, command, action, seed)
        of = {"reset": command == Command.RESET, "middle": toys.steps == 3}
        of["end"] = step.terminated | step.truncated
        which = of[at] & (toys.seed % 2 == 0)
        leaf = getattr(step, field)
        bad = which.reshape(-1, *[1] * (leaf.ndim - 1))
        return toys, dataclasses.replace(step, **{field: jnp.where(bad, jnp.nan, leaf)})

    monkeypatch.setattr(device_toy, "_tick", tick)


_MOMENTS = [
    ("observation", "middle"),
    ("reward", "end"),
    pytest.param("observation", "reset", marks=pytest.mark.slow),
    pytest.param("observation", "end", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("field", "at"), _MOMENTS)
def test_the_device_ends_a_run_where_the_host_does(field, at, monkeypatch):
    _broken(monkeypatch, field, at)

    def play():
        with device_toy.toys():
            specs = _specs(12)
            playing = Rollout(agents.make_agent(CONFIG), specs, JaxPool(4, 2), LOOP)
            runs = {run.run.spec.seed: run.run for done in playing for run in done}
            return [(runs[seed].diverged, repr(runs[seed].episodes)) for seed in range(2)]

    on_device = play()
    assert {lost.quantity for lost, _ in on_device if lost} == {field}
    monkeypatch.setattr(rollout, "make_stage", host_stage.HostStage)
    assert play() == on_device


def _finished():
    agent = agents.make_agent(CONFIG)
    train = compiled.init(agent, jax.random.key(3))
    spec = RunSpec(Method.HITL_AC, 0, hyper_for(Method.HITL_AC, HYPER), 9)
    return agent, FinishedRun(Run(spec, 0), train, np.float32(0.25))


@pytest.mark.parametrize(
    ("field", "at"),
    [*_MOMENTS, pytest.param("reward", "middle", marks=pytest.mark.slow)],
)
def test_both_examiners_count_a_fall_and_say_so(field, at, monkeypatch):
    _broken(monkeypatch, field, at)
    agent, run = _finished()
    with device_toy.toys():
        on_device = evaluate_runs(
            DeviceExaminer(agent, JaxPool(64, 2), 20), [run], lambda _: ("autonomous",)
        )
        by_host = evaluate_runs(
            HostExaminer(agent, JaxPool(20, 1)), [run], lambda _: ("autonomous",)
        )
    [(rows, _)], [(same, _)] = on_device, by_host
    assert repr(rows) == repr(same)
    lost = [row for row in rows if row.get(NOT_FINITE)]
    assert 0 < len(lost) == num_lost(rows) < 20
    assert {(row["return"], row["length"], row["end"]) for row in lost} == {(-100.0, 1, "fall")}
    assert all(np.isfinite(row["return"]) for row in rows)


def test_parameters_that_are_no_numbers_are_said_as_well():
    agent, run = _finished()
    actor = jax.tree.map(lambda leaf: leaf * np.nan, run.train.learner.actor)
    average = run.train.average.replace(params=actor)
    sick = run.train.replace(learner=run.train.learner.replace(actor=actor), average=average)
    run = FinishedRun(run.run, sick, run.boundary)
    [(rows, _)] = evaluate_runs(HostExaminer(agent, ToyPool(3)), [run], lambda _: ("autonomous",))
    assert num_lost(rows) == 3
