import compiled
import jax
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper
from toy import ToyPool

from hitl_jax.config import Method, hyper_for
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import evaluate_runs
from hitl_jax.team import agent as agents
from hitl_jax.training.run_spec import FinishedRun, Run, RunSpec, Snapshot

_SEEDS = np.arange(5, dtype=np.uint32)


def _evaluate(mode, method=Method.HITL_AC, boundary=0.4, seeds=_SEEDS, config=None, **changes):
    config = config or paper_config(hidden_sizes=(16,))
    agent = agents.make_agent(config)
    params = agents.behavior(compiled.init(agent, jax.random.key(0)))
    hyper = hyper_for(method, paper_hyper(takeover_steps=3, delta_minus=0.1, **changes))
    evaluator = HostExaminer(agent, ToyPool(len(seeds)))
    policy = jax.tree.map(lambda leaf: leaf[None], params)
    boundary = np.full(1, boundary, np.float32)
    return evaluator.evaluate(mode, hyper, policy, boundary, jax.random.key(1), seeds[None])


def test_autonomous_records_alarms_and_nobody_acts():
    rows = _evaluate("autonomous")
    assert [row["episode"] for row in rows] == [1, 2, 3, 4, 5]
    assert {row["mode"] for row in rows} == {"autonomous"}
    assert sum(row["alarms"] for row in rows) > 0
    assert all(row["interventions"] == row["human_steps"] == 0 for row in rows)
    # Frozen: Δ⁻ = 0.1 would have moved the boundary at the first true alarm.
    np.testing.assert_allclose([row["mean_boundary"] for row in rows], 0.4, rtol=1e-5)


def test_assisted_takes_over_whatever_training_did():
    rows = _evaluate("assisted", config=paper_config(hidden_sizes=(16,), intervention="reset"))
    assert sum(row["interventions"] for row in rows) > 0
    assert sum(row["human_steps"] for row in rows) >= sum(row["interventions"] for row in rows)
    assert all(row["end"] != "human-reset" for row in rows)


def test_there_is_no_noise():
    loud = _evaluate("autonomous", exploration_noise=0.9, warmup_steps=10_000)
    quiet = _evaluate("autonomous", exploration_noise=0.0, warmup_steps=0)
    assert [row["return"] for row in loud] == [row["return"] for row in quiet]


def test_an_episode_does_not_depend_on_its_place():
    # The toy walkers differ by their seeds alone, and nothing is random in a test.
    forward, backward = _evaluate("autonomous"), _evaluate("autonomous", seeds=_SEEDS[::-1])
    assert [row["return"] for row in forward] == pytest.approx(
        [row["return"] for row in backward][::-1], rel=1e-5
    )


def test_snapshots_share_the_walkers_and_are_tested_as_the_end_is():
    agent = agents.make_agent(paper_config(hidden_sizes=(16,)))
    trained = [compiled.init(agent, jax.random.key(seed)) for seed in range(3)]
    spec = RunSpec(Method.HITL_AC, 0, hyper_for(Method.HITL_AC, paper_hyper()), episodes=9)
    snapshots = [
        Snapshot(3 * (n + 1), agents.behavior(state), np.float32(0.3 + 0.1 * n))
        for n, state in enumerate(trained)
    ]
    run = FinishedRun(Run(spec, 0, snapshots=snapshots), trained[1], np.float32(0.4))

    def test(walkers, *modes):
        examiner = HostExaminer(agent, ToyPool(walkers))
        return evaluate_runs(examiner, [run], lambda _: modes or ("autonomous",))

    # Three policies on seven walkers: two episodes each, and one walker stands still.
    [(_, rows)] = test(7)
    assert [(row["trained"], row["episode"]) for row in rows] == [
        *((3, 1), (3, 2), (6, 1), (6, 2), (9, 1), (9, 2)),
    ]
    [(_, both)] = test(7, "autonomous", "assisted")
    assert [row["mode"] for row in both] == ["autonomous"] * 6 + ["assisted"] * 6
    assert repr(both[:6]) == repr(rows)
    assert [row["trained"] for row in both[6:]] == [row["trained"] for row in rows]
    # As many of each policy, also where they do not go into one test.
    [(_, few)] = test(2)
    assert [(row["trained"], row["episode"]) for row in few] == [(3, 1), (6, 1), (9, 1)]
    [(_, one)] = test(1)
    assert [row["trained"] for row in one] == [3, 6, 9]
    [(tested, _)] = test(2)
    for row, alone in zip(rows[2:4], tested, strict=True):
        assert row["return"] == pytest.approx(alone["return"], rel=1e-5)
        assert row["mean_boundary"] == pytest.approx(0.4)


def test_without_an_arbiter_there_is_no_boundary():
    rows = _evaluate("autonomous", method=Method.SRL)
    assert all(np.isnan(row["mean_boundary"]) and row["alarms"] == 0 for row in rows)
