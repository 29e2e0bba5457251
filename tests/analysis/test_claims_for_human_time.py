"""The claim on equal human time, on made-up runs."""

import pytest
from example_runs import make_run

from hitl_jax.analysis.claims import judge
from hitl_jax.analysis.verdicts import HOLDS, HOLDS_NOT, UNDECIDED

_BOUNDS = (0.05, 1.5)


def _helped(method, seed, rises_at, test_return):
    """A run whose human acts for 0.1 s in each of 1000 episodes."""
    run = make_run(method, seed, rises_at, test_return + seed)
    run.episodes["human_steps"][:] = 5
    return run


@pytest.mark.parametrize(
    ("fix", "ac", "verdict"),
    [
        ((500, 300.0), (200, 320.0), HOLDS),
        ((500, 300.0), (200, 300.0), UNDECIDED),  # After 600 s, which none takes, both walk alike.
        ((200, 300.0), (500, 300.0), HOLDS_NOT),
    ],
)
def test_return_is_judged_at_equal_human_time(fix, ac, verdict):
    of = {"srl": (600, 300.0), "hitl-fix": fix, "hitl-ac": ac}
    made = {
        method: [_helped(method, seed, *how) for seed in range(5)] for method, how in of.items()
    }
    [claim] = [one for one in judge(made, 0.45, _BOUNDS) if one.name == "Return for human time"]
    assert claim.verdict == verdict
    assert claim.measured.endswith(
        "In all the human acted for HITL-AC 100 [100, 100], HITL-FIX 100 [100, 100] s"
    )
    if verdict == UNDECIDED:
        first, *_, last = claim.measured.split("; ")
        # 30 s are 300 episodes: HITL-FIX falls until 500.
        assert first.startswith("30 s: HITL-AC 302 [301, 303], HITL-FIX -100 [-100, -100], ahead")
        assert last.startswith(
            "600 s: HITL-AC 302 [301, 303], HITL-FIX 302 [301, 303], ahead by +0"
        )


def test_before_the_first_test_the_return_rises_from_that_of_a_fall():
    methods = ("srl", "hitl-fix", "hitl-ac")
    made = {m: [_helped(m, seed, 50, 300.0) for seed in range(5)] for m in methods}
    for run in made["hitl-ac"]:
        run.episodes["human_steps"][:] = 3000  # 60 s an episode, and 3000 s before the first test
    [claim] = [one for one in judge(made, 0.45, _BOUNDS) if one.name == "Return for human time"]
    # A fiftieth of the way from -100 to 302, and the walker.
    assert "60 s: HITL-AC -92 [-92, -92], HITL-FIX 302 [301, 303]" in claim.measured


def test_where_no_human_acts_there_is_no_human_time():
    methods = ("srl", "hitl-fix", "hitl-ac")
    made = {m: [make_run(m, seed, 300, 200.0) for seed in range(5)] for m in methods}
    assert "Return for human time" not in [claim.name for claim in judge(made, 0.45, _BOUNDS)]
