"""What the benchmark counts and says; its figures are no test's business."""

import pytest

from experiments.benchmark import BenchmarkOptions, main
from experiments.benchmarks import peers
from experiments.benchmarks.learner import update_flops
from experiments.cli import run_main
from hitl_jax.config import AgentConfig


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--only", "speed"], "--only speed: must be some of learner, pool, loop, scaling, peers"),
        (["--only"], "--only"),
        (["--tile", "0"], "--tile 0: must be at least 1"),
        (["--seconds", "0"], "--seconds 0.0: must be above 0"),
        (["--json", "/no/such/folder/a.json"], "--json /no/such/folder/a.json"),
        (["--plot", "/no/such/folder/a.png"], "--plot /no/such/folder/a.png"),
    ],
)
def test_bad_input_is_one_line(args, said, capsys):
    assert run_main(BenchmarkOptions, main, args) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_flops_of_an_update_counted_by_hand():
    """One input, one hidden unit, one action: actor 1 + 1 products, critic 2 + 1."""
    config = AgentConfig(
        learner="ddpg", hidden_sizes=(1,), batch_size=1, observation_size=1, action_size=1
    )
    target = 2 + 3
    critic = 3 + 3 + 3 - 2  # forward, both gradients, less that of the input
    policy = (2 + 2 + 2 - 1) + 3 + (1 + 1)  # actor, critic, and back to the action
    assert update_flops(config) == 2 * (target + critic + policy)


def test_a_missing_peer_is_named():
    ways = [
        ("theirs", "no-such-package", lambda _: 1.0),
        ("ours", "hitl_jax", lambda _: 2.0),
    ]
    theirs, ours = peers._rows(ways, 1.0, ratio_to=0, bar=3.0)
    assert "missing" in theirs["peer"]
    assert '".[bench]"' in theirs["peer"]
    assert ours["steps/s"] == 2
    assert "ratio" not in ours
