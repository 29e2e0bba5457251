"""What the benchmark counts and says; its figures are no test's business."""

import contextlib
import subprocess
import sys
import threading

import jax
import numpy as np
import pytest
import small
from toy import ToyPool

from hitl_jax.benchmarks import loop, peers, scaling
from hitl_jax.benchmarks.learner import make_learner, update_flops
from hitl_jax.benchmarks.timing import busy_seconds, memory_mb, stolen_seconds
from hitl_jax.commands.benchmark import main
from hitl_jax.config import AgentConfig, Method
from hitl_jax.console.cli import run_main
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig
from hitl_jax.xla.devices import learning_devices


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (
            ["--only", "speed"],
            "--only speed: must be some of learner, pool, loop, scaling, saves, logs, walkers, "
            "live, launchers, peers",
        ),
        (["--only", "learner,speed"], "--only learner,speed: must be some of"),
        (["--only"], "--only"),
        (["--seconds", "0"], "--seconds 0.0: must be above 0"),
        (["--json", "/no/such/folder/a.json"], "--json /no/such/folder/a.json"),
        (["--plot", "/no/such/folder/a.png"], "--plot /no/such/folder/a.png"),
        (["--plot", "a.pdf"], "--plot a.pdf: must end with .png or .svg"),
        (["--plot", "a.png", "--only", "loop"], "--plot a.png: needs the part scaling"),
    ],
)
def test_bad_input_is_one_line(args, said, capsys):
    assert run_main("benchmark", main, args) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_the_default_team_is_measured():
    """With its human's options, which `Hyper` alone has not."""
    config = AgentConfig(
        learner="ddpg", hidden_sizes=(8,), batch_size=8, boundary_hidden_sizes=(8,)
    )
    runs = 2 * len(learning_devices())
    learn = make_learner(config, runs, 2, LoopConfig(capacity=512))
    before = [np.array(train) for train in learn()]
    assert all((one != other).any() for one, other in zip(before, learn(), strict=True))


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
    ways = [("theirs", "no-such-package", lambda _: 1.0), ("ours", "hitl_jax", lambda _: 2.0)]
    theirs, ours = peers.compared(ways, "theirs", 1.0, bar=3.0)
    assert "missing" in theirs["peer"]
    assert '".[bench]"' in theirs["peer"]
    assert ours["steps/s"] == 2
    assert "ratio" not in ours


def test_ours_are_compared_with_the_reference_and_with_the_best_of_the_others():
    """Turn by turn, since a machine may be slow in one of them."""
    rates = {"jax": [3.0, 1.0, 9.0], "numpy": [1.0, 2.0, 4.0], "hitl_jax": [3.0, 4.0, 18.0]}
    turns = {name: iter(rate) for name, rate in rates.items()}
    ways = [(name, name, lambda _, turn=turn: next(turn)) for name, turn in turns.items()]
    *others, ours = peers.compared(ways, "numpy", 1.0, bar=3.0)
    assert ours["steps/s"] == 4
    assert ours["ratio"] == 3.0  # of 3, 2 and 4.5; 4 / 2 by the medians
    assert ours["to the best"] == 2.0  # of 3 / 3, 4 / 2 and 18 / 9; 4 / 3 by the medians
    assert ours["bar"] == 3.0
    assert not any("bar" in other for other in others)


def test_growth_with_runs_is_drawn(tmp_path):
    row = {"steps/s": 5000, "updates/s": 2500, "µs a run-step": 200, "memory GB": 1.2}
    row |= {"first start s": 20.0, "second start s": 9.0}
    scaling.draw_scaling([{"runs": runs, **row} for runs in (1, 10)], str(tmp_path / "a.png"))
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_steps_of_a_stretch_are_counted_without_resets():
    specs = loop.specs_of([Method.SRL, Method.HITL_AC], 4)
    pool = ToyPool(4)
    rollout = Rollout(make_agent(small.AGENT), specs, pool, small.LOOP)
    chunks = iter(rollout)
    next(chunks)
    before = pool.steps
    played = loop.play(rollout, chunks, 0.2)
    # Between the end of an episode and its reset a walker has one tick to come.
    assert abs(played.steps - (pool.steps - before)) <= 4
    assert played.steps < 4 * played.ticks


@contextlib.contextmanager
def _child(before):
    """A process that has done something and waits."""
    command = [sys.executable, "-c", f"{before}; print('up', flush=True); input()"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe) as child:
        child.stdout.readline()
        yield
        child.communicate(b"\n")


def test_memory_of_children_is_added():
    with _child("pass"):
        assert memory_mb(children=True) > memory_mb() + 2


def test_stolen_time_only_grows():
    before = stolen_seconds()
    assert 0 <= before <= stolen_seconds()


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc and priorities")
def test_busy_are_learners_and_children_not_this_thread():
    before = busy_seconds()
    sum(range(10**7))
    with _child("sum(range(10**7))"):
        after = busy_seconds()
        assert after.walkers - before.walkers > 0.05
    assert after.learner - before.learner < 0.02
    product = jax.jit(lambda x: x @ x)
    x = jax.device_put(np.ones((1500, 1500), np.float32), learning_devices()[0])
    product(x).block_until_ready()
    assert busy_seconds().learner - after.learner > 0.01


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's /proc")
def test_threads_that_end_meanwhile_break_no_measurement():
    ended, interval = threading.Event(), sys.getswitchinterval()

    def start_and_end():
        while not ended.is_set():
            thread = threading.Thread(target=lambda: None)
            thread.start()
            thread.join()

    starting = threading.Thread(target=start_and_end)
    starting.start()
    sys.setswitchinterval(1e-6)
    try:
        for _ in range(500):
            assert busy_seconds().walkers >= 0
            assert memory_mb(children=True) > 0
    finally:
        sys.setswitchinterval(interval)
        ended.set()
        starting.join()
