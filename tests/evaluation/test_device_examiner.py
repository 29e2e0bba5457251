"""Tests of many runs at once are those of each alone, with a toy in the place of the walker."""

import dataclasses

import compiled
import device_toy
import jax
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.arbiter import INTERVENTIONS
from hitl_jax.boundary import SOURCES
from hitl_jax.choices.options import Option
from hitl_jax.config import Method, hyper_for
from hitl_jax.envs.jax_pool import JaxPool
from hitl_jax.evaluation.device import DeviceExaminer, num_walkers
from hitl_jax.evaluation.examiners import make_examiner
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import evaluate_runs
from hitl_jax.team import agent as agents
from hitl_jax.training.run_spec import FinishedRun, Run, RunSpec, Snapshot

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("compiled_fully")]

_AGENT = agents.make_agent(paper_config(learner="td3", hidden_sizes=(16,)))
_EPISODES = 20  # of a test: more than a table has, and no multiple of it


def _modes(method):
    return ("autonomous",) if method is Method.SRL else ("autonomous", "assisted")


def _finished(method, seed):
    hyper = hyper_for(
        method, paper_hyper(initial_boundary=0.3, takeover_steps=3, exploration_noise=0.5)
    )
    states = [compiled.init(_AGENT, jax.random.key(10 * seed + n)) for n in range(4)]
    early = [jax.device_get(agents.behavior(state)) for state in states[:-1]]
    snapshots = [Snapshot(n, one, np.float32(0.2 + n / 10)) for n, one in enumerate(early, 1)]
    run = Run(RunSpec(method, seed, hyper, episodes=9), 0, snapshots=snapshots)
    return FinishedRun(run, states[-1], np.float32(0.25))


@pytest.fixture(scope="module")
def runs():
    return [_finished(method, seed) for seed in range(2) for method in Method]


def _examined(runs, walkers, devices=2, broken_from=device_toy.NEVER, agent=_AGENT):
    with device_toy.toys(broken_from):
        examiner = make_examiner(agent, JaxPool(walkers, devices), _EPISODES)
        assert isinstance(examiner, DeviceExaminer)
        return evaluate_runs(examiner, runs, _modes)


@pytest.fixture(scope="module")
def together(runs):
    return _examined(runs, 64)


def test_host_and_device_tell_the_same(runs, together):
    with device_toy.toys():
        by_host = evaluate_runs(HostExaminer(_AGENT, JaxPool(_EPISODES, 1)), runs, _modes)
    assert repr(together) == repr(by_host)
    rows = [row for at_end, _ in together for row in at_end]
    assert len(rows) == 2 * (20 + 40 + 40)
    assert {row["end"] for row in rows} == {"goal", "time-limit"}
    assert sum(row["human_steps"] for row in rows) > 0


@pytest.mark.parametrize(("walkers", "devices"), [(32, 1), (256, 2)])
def test_the_number_of_walkers_does_not_matter(runs, together, walkers, devices):
    assert repr(_examined(runs, walkers, devices)) == repr(together)


def test_company_does_not_matter(runs, together):
    assert repr(_examined(runs[3:4], 64)) == repr(together[3:4])


def test_options_that_are_not_given_have_their_defaults(runs, together):
    """Beside policies to which they are given, those of an intervention of training included."""
    drifts = Option("drift", 0.001, "what τ loses in a step")
    agent = agents.make_agent(
        _AGENT.config,
        boundary_source=SOURCES.make("rule")._replace(options=(drifts,)),
        intervention=INTERVENTIONS.make("reset")._replace(options=(Option("rest", 1.0, "x"),)),
    )
    first = runs[0].run
    given = first.spec.hyper.replace(extra={"rest": 1.0})
    run = dataclasses.replace(first, spec=dataclasses.replace(first.spec, hyper=given))
    told = FinishedRun(run, runs[0].train, runs[0].boundary)
    assert repr(_examined([told, *runs[1:]], 64, agent=agent)) == repr(together)


def test_a_policy_that_is_no_number_falls_at_once(runs, together):
    lost = _finished(Method.SRL, 0)
    actor = jax.tree.map(lambda leaf: leaf * np.nan, lost.train.learner.actor)
    sick = FinishedRun(
        lost.run, lost.train.replace(learner=lost.train.learner.replace(actor=actor)), lost.boundary
    )
    (fallen, early), *others = _examined([sick, *runs[1:]], 64)
    assert [(row["episode"], row["end"]) for row in fallen] == [(n, "fall") for n in range(1, 21)]
    assert repr(early) == repr(together[0][1])
    assert repr(others) == repr(together[1:])


def test_a_reward_that_is_no_number_is_a_fall(runs):
    for at_end, _ in _examined(runs[:1], 64, broken_from=3):
        assert {(row["end"], row["return"]) for row in at_end} == {("fall", -100.0)}


def test_between_chunks_it_can_be_broken_off(runs):
    def stop():
        raise InterruptedError

    with device_toy.toys():
        examiner = make_examiner(_AGENT, JaxPool(64, 2), _EPISODES)
        with pytest.raises(InterruptedError):
            evaluate_runs(examiner, runs, _modes, stop)


@pytest.mark.parametrize(("episodes", "walkers"), [(1, 64), (100, 128), (5000, 1024)])
def test_as_many_walkers_as_are_of_use(episodes, walkers):
    assert num_walkers(episodes, 2) == walkers
