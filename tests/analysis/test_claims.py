"""Verdicts on the claims of the paper, on made-up runs."""

import dataclasses

import numpy as np
import pytest
from example_runs import make_run

from hitl_jax.analysis.claims import judge
from hitl_jax.analysis.claims_over_steps import area_of
from hitl_jax.analysis.summary import skill_over_training
from hitl_jax.analysis.verdicts import HOLDS, HOLDS_NOT, UNDECIDED
from hitl_jax.results.episode_tables import PROGRESS_COLUMNS, to_table
from hitl_jax.results.run_key import RunKey

_BOUNDS = (0.05, 1.5)


def _judge(srl, fix, ac):
    runs = {"srl": srl, "hitl-fix": fix, "hitl-ac": ac}
    made = {
        m: [make_run(m, seed, **kwargs) for seed, kwargs in enumerate(of)] for m, of in runs.items()
    }
    return {claim.name: claim for claim in judge(made, 0.45, _BOUNDS)}


def test_the_seeds_that_a_difference_takes_by_hand():
    """The areas of HITL-FIX differ from SRL's by what the tests do, and from HITL-AC's by none."""
    claims = _judge(
        srl=[{"rises_at": 50, "test_return": 100.0}] * 6,
        fix=[{"rises_at": 50, "test_return": value} for value in (200.0, 300.0) * 3],
        ac=[{"rises_at": 50, "test_return": value} for value in (210.0, 310.0) * 3],
    )
    told = claims["Seeds needed"].measured
    # Until the first test, at 50 of 1000 episodes, the return rises to the test's.
    spread = np.std([100.0, 200.0] * 3, ddof=1) * (1 - 0.5 * 50 / 1000)
    seeds = int(np.ceil((2.802 * spread / 20.0) ** 2))
    assert told.startswith(f"HITL-AC and HITL-FIX 5 [5, 5], HITL-FIX and SRL {seeds} [")


def test_a_run_that_lacks_a_test_has_no_area():
    run = make_run("srl", 0, 50, 200.0)
    points = np.unique(run.progress["trained"])
    # From the fall at once before the first test on.
    assert area_of(run, points) < run.tests["return"].mean()
    assert area_of(run, [*points, 999]) is None


def test_all_claims_can_hold():
    claims = _judge(
        srl=[{"rises_at": 600, "test_return": 200.0 + seed} for seed in range(5)],
        fix=[{"rises_at": 400, "test_return": 280.0 + seed} for seed in range(5)],
        ac=[
            {"rises_at": 250, "test_return": 310.0 + seed, "assisted": 15.0, "falls_every": 2}
            for seed in range(5)
        ],
    )
    verdicts = {name: claim.verdict for name, claim in claims.items()}
    reported = "Alarms before falls", "Skill over training", "Seeds needed"
    assert {verdicts.pop(name) for name in reported} == {"–"}
    assert set(verdicts.values()) == {HOLDS}
    # Of 100 returns of 300 or -100, 75 of 300 make a mean of 200.
    speed = claims["Training speed (Figure 4)"].measured
    assert speed == (
        "episode: HITL-AC 324 [324, 324], HITL-FIX 474 [474, 474], SRL 674 [674, 674]; "
        "so in 100 % of resamples of the seeds"
    )
    assert claims["Training speed over environment steps"].measured == (
        "thousands of steps: HITL-AC 0 [0, 0], HITL-FIX 0 [0, 0], SRL 1 [1, 1]; "
        "so in 100 % of resamples of the seeds"
    )
    # Two tests of ten episodes each are looked at: from 300 and from 650 on both are of a walker.
    assert claims["Steps to a test of 200"].measured == (
        "thousands of steps: HITL-AC 0 [0, 0], HITL-FIX 0 [0, 0], SRL 1 [1, 1]; "
        "so in 100 % of resamples of the seeds"
    )
    assert claims["Falls during training"].measured == (
        "620 falls beside 2995: 0.21 [0.21, 0.21]; so in 100 % of resamples of the seeds"
    )
    assert claims["Area under the tests"].measured.endswith(
        "HITL-AC over HITL-FIX 1.00 [1.00, 1.00], HITL-FIX over SRL 1.00 [1.00, 1.00]"
    )
    assert claims["Help in the test"].measured == (
        "+15.0 [+15.0, +15.0]; above it by more than 1 in 5 of 5 seeds"
    )
    assert claims["Help in the test, over training"].measured == (
        "+15.0 [+15.0, +15.0]; above it at 19 of 19 points, from +15 to +15"
    )
    assert claims["Skill with the human's help"].measured.startswith("HITL-AC 327.0 [325.8, 328.2]")
    assert claims["Alarms before falls"].measured == "5 of 10 falls; 0.20 s before it by the median"
    boundary = claims["The boundary (Figure 6)"].measured
    assert "for good from episode 300 on by the median (300 to 300)" in boundary


def test_skill_over_training_is_over_equal_terrains():
    progress = dict.fromkeys(PROGRESS_COLUMNS, np.zeros(2)) | {
        "trained": [200, 400],
        "mode": ["autonomous"] * 2,
        "episode": [1, 1],
        "return": [10.0, 250.0],
        "end": ["fall", "goal"],
    }
    run = make_run("hitl-ac", 0, rises_at=300, test_return=300.0)
    run.tests["return"][1] = -100.0  # of a terrain that the earlier tests did not have
    run = dataclasses.replace(run, progress=to_table(progress, PROGRESS_COLUMNS))
    skill = skill_over_training([run])
    assert skill.points.tolist() == [200, 400, 1000]
    assert skill.returns.tolist() == [[10.0, 250.0, 300.0]]
    # One of an earlier or later version, which was tested at other points, and longer.
    other = make_run("hitl-ac", 1, rises_at=300, test_return=200.0)
    assert skill_over_training([other]).points.tolist() == [*range(50, 1000, 50), 1000]
    both = skill_over_training([run, other])
    assert (both.points.tolist(), both.episodes) == ([200, 400, 1000], 1)
    assert both.returns.tolist() == [[10.0, 250.0, 300.0], [-100.0, 200.0, 200.0]]
    runs = [dataclasses.replace(run, key=RunKey("hitl-ac", seed)) for seed in range(5)]
    compared = dict.fromkeys(("srl", "hitl-fix", "hitl-ac"), runs)
    claims = judge(compared, 0.45, _BOUNDS)
    [claim] = [claim for claim in claims if claim.name == "Skill over training"]
    assert "episode 400: HITL-AC 250 [250, 250]" in claim.measured
    assert "the same 1 test episodes" in claim.aim


def _diverged(run, episodes):
    """A run that diverged: from there on its training episodes are falls of one step."""
    lost = run.episodes["episode"] > episodes
    steps = np.where(lost, episodes + 0.01 * (run.episodes["episode"] - episodes), 0)
    table = run.episodes | {
        "env_steps": np.where(lost, steps, run.episodes["env_steps"]),
        "fall": np.where(lost, 1, run.episodes["fall"]),
    }
    info = run.info | {"diverged": {"quantity": "q", "env_steps": episodes, "episodes": episodes}}
    return dataclasses.replace(run, info=info, episodes=table)


def test_what_a_diverged_run_could_not_play_is_no_fall_and_cuts_no_other_short():
    runs = {
        method: [make_run(method, seed, rises_at=400, test_return=300.0) for seed in range(5)]
        for method in ("srl", "hitl-fix", "hitl-ac")
    }
    before = {claim.name: claim for claim in judge(runs, 0.45, _BOUNDS)}
    assert before["Falls during training"].measured.startswith("1995 falls beside 1995: 1.00 [")
    runs["srl"][0] = _diverged(runs["srl"][0], 200)
    after = {claim.name: claim for claim in judge(runs, 0.45, _BOUNDS)}
    assert after["Falls during training"].measured.startswith("1995 falls beside 1796: 1.11 [")
    own = [claims["Area under the tests"].measured.split(",")[0] for claims in (before, after)]
    assert own[0] == own[1]


def test_too_few_tests_tell_of_no_steps():
    runs = {
        method: [make_run(method, seed, rises_at=400, test_return=300.0) for seed in range(5)]
        for method in ("srl", "hitl-fix", "hitl-ac")
    }
    for run in [one for of in runs.values() for one in of]:
        run.progress["episode"][:] = 1
    assert "Steps to a test of 200" not in [claim.name for claim in judge(runs, 0.45, _BOUNDS)]


def test_all_claims_can_fail():
    claims = _judge(
        srl=[{"rises_at": 300, "test_return": 300.0 + seed} for seed in range(5)],
        fix=[{"rises_at": 400, "test_return": 280.0 + seed} for seed in range(5)],
        ac=[
            {
                "rises_at": 2000,
                "test_return": 200.0 + seed,
                "assisted": -5.0,
                "end": 0.6,
                "interventions": (1, 3),
            }
            for seed in range(5)
        ],
    )
    verdicts = {name: claim.verdict for name, claim in claims.items()}
    del verdicts["Alarms before falls"], verdicts["Skill over training"], verdicts["Seeds needed"]
    assert set(verdicts.values()) == {HOLDS_NOT}
    assert "HITL-AC never [never, never]" in claims["Training speed (Figure 4)"].measured


def test_what_the_seeds_do_not_decide_is_said():
    ac = [{"rises_at": 300, "test_return": value} for value in (310.0, 320.0, 330.0, 200.0, 340.0)]
    fix = [{"rises_at": 400, "test_return": 305.0}] * 5
    srl = [{"rises_at": 600, "test_return": 100.0}] * 5
    claims = _judge(srl, fix, ac)
    assert claims["How sure that order is"].verdict == UNDECIDED
    assert claims["Skill without the human (Figure 5)"].verdict == UNDECIDED


def test_only_seeds_of_all_methods_count():
    runs = {m: [make_run(m, seed, 300, 200.0) for seed in range(5)] for m in ("srl", "hitl-fix")}
    with pytest.raises(ValueError, match="0 seeds done in all methods, of at least 5"):
        judge(runs, 0.45, _BOUNDS)
    runs["hitl-ac"] = [make_run("hitl-ac", seed, 300, 200.0) for seed in range(1, 6)]
    with pytest.raises(ValueError, match="4 seeds done in all methods"):
        judge(runs, 0.45, _BOUNDS)


def test_a_boundary_that_never_settles_is_said_to():
    ac = [{"rises_at": 300, "test_return": 310.0, "end": 0.49}] * 5
    claims = _judge([{"rises_at": 300, "test_return": 200.0}] * 5, ac, ac)
    assert "from episode never on" in claims["The boundary (Figure 6)"].measured


@pytest.mark.parametrize(
    ("means", "verdict", "told"),
    [
        ([0.3] * 9 + [0.05], HOLDS, "9 of 10 seeds, from 0.050 to 0.300"),
        ([0.3] * 8 + [1.48, 0.05], HOLDS_NOT, "8 of 10 seeds, from 0.050 to 1.480"),
        ([0.3] * 9 + [np.nan], UNDECIDED, "9 of 10 seeds"),
        ([1.5] * 10, HOLDS_NOT, "0 of 10 seeds, from 1.500 to 1.500"),
        ([np.nan] * 10, UNDECIDED, "0 of 10 seeds, of no known boundary"),
    ],
)
def test_where_the_human_goes_by_no_angle_the_boundary_must_run_to_neither_bound(
    means, verdict, told
):
    made = {}
    for method in ("srl", "hitl-fix", "hitl-ac"):
        made[method] = [make_run(method, seed, 300, 200.0) for seed in range(10)]
        for run, mean in zip(made[method], means, strict=True):
            run.episodes["mean_boundary"][:-20] = 1.5
            run.episodes["mean_boundary"][-20:] = mean
            run.episodes["mean_boundary"][-1] = np.nan  # An episode without the human.
    [claim] = [claim for claim in judge(made, None, _BOUNDS) if "Figure 6" in claim.name]
    assert claim.verdict == verdict
    assert claim.measured.startswith(told)


@pytest.mark.parametrize("who", ["srl", "fix", "ac"])
def test_a_claim_about_what_is_no_number_is_not_decided(who):
    runs = {
        "srl": [{"rises_at": 600, "test_return": 200.0 + seed} for seed in range(5)],
        "fix": [{"rises_at": 400, "test_return": 280.0 + seed} for seed in range(5)],
        "ac": [{"rises_at": 250, "test_return": 310.0 + seed} for seed in range(5)],
    }
    made = {
        method: [make_run(method, seed, **kwargs) for seed, kwargs in enumerate(runs[name])]
        for method, name in (("srl", "srl"), ("hitl-fix", "fix"), ("hitl-ac", "ac"))
    }
    [lost, *_] = made[{"srl": "srl", "fix": "hitl-fix", "ac": "hitl-ac"}[who]]
    # A table refuses these: no file could bring them.
    lost.tests["return"][:] = np.nan
    lost.episodes["return"][100:] = np.nan
    lost.episodes["interventions"] = np.full(1000, np.nan)
    lost.episodes["final_boundary"][-1] = np.nan
    claims = {claim.name: claim.verdict for claim in judge(made, 0.45, _BOUNDS)}
    concerned = ["Training speed (Figure 4)", "Skill without the human (Figure 5)"]
    concerned += ["Training speed over environment steps"] * (who != "fix")
    if who == "ac":
        concerned += ["The boundary (Figure 6)", "The human's work falls", "Help in the test"]
    assert {claims[name] for name in concerned} == {UNDECIDED}
    assert claims["How sure that order is"] == UNDECIDED
