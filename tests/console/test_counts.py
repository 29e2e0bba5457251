"""Counts and seeds out of range are one line, in the library and in the commands alike."""

import dataclasses
import re

import numpy as np
import pytest
from toy import ToyPool

from hitl_jax import human
from hitl_jax.choices.checks import require, require_whole
from hitl_jax.commands import ablation, agreement, brax_ppo, seed_sweep, tuning
from hitl_jax.config import AgentConfig, Hyper, Method, hyper_for
from hitl_jax.console.cli import run_main
from hitl_jax.envs import make_pool
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.human.judgement import HumanParams
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.team.agent import make_agent
from hitl_jax.training import batch_arrays
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec, num_slots

_SPEC = RunSpec(Method.SRL, 0, hyper_for(Method.SRL, Hyper()), 10, (2, 5))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"episodes": 0}, "episodes 0: must be at least 1 and at most 2147483647"),
        ({"episodes": 2**31}, "episodes 2147483648: must be at least 1 and at most 2147483647"),
        ({"episodes": 10.0}, "episodes 10.0: must be a whole number"),
        ({"episodes": True}, "episodes True: must be a whole number"),
        ({"episodes": float("nan")}, "episodes nan: must be a whole number"),
        ({"episodes": 10**400}, "must be a finite number"),
        ({"seed": -5}, "seed -5: must be at least 0 and at most 4294967295"),
        ({"seed": 2**32}, "seed 4294967296: must be at least 0 and at most 4294967295"),
        ({"seed": np.int64(-1)}, "seed -1: must be at least 0"),
        ({"seed": 1.5}, "seed 1.5: must be a whole number"),
        ({"seed": "3"}, "seed 3: must be a whole number"),
        ({"snapshots": (0,)}, "snapshots 0: must be at least 1 and at most 10"),
        ({"snapshots": (5, 5)}, "snapshots 5: must be at least 6 and at most 10"),
        ({"snapshots": (5, 2)}, "snapshots 2: must be at least 6 and at most 10"),
        ({"snapshots": (11,)}, "snapshots 11: must be at least 1 and at most 10"),
        ({"snapshots": (2.0,)}, "snapshots 2.0: must be a whole number"),
        ({"method": "ppo"}, "method ppo: must be one of srl, hitl-fix, hitl-ac"),
        ({"setting": "A b"}, "setting 'A b': must be lower-case letters and digits"),
    ],
)
def test_a_run_that_cannot_be(change, message):
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        dataclasses.replace(_SPEC, **change)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"warmup_steps": 2.5}, "warmup_steps 2.5: must be a whole number"),
        ({"warmup_steps": 2**31}, "warmup_steps 2147483648: must be at least 0 and at most"),
        ({"noise_free_every": -1}, "noise_free_every -1: must be at least 0"),
        ({"takeover_steps": True}, "takeover_steps True: must be a whole number"),
        ({"gamma": float("nan")}, "gamma nan: must be a finite number"),
        ({"gamma": np.float64("nan")}, "gamma nan: must be a finite number"),
        ({"feedback": -1e39}, "feedback -1e+39: must be a finite number"),
        ({"actor_learning_rate": 1e39}, "actor_learning_rate 1e+39: must be a finite number"),
        ({"human": HumanParams(delay=-1)}, "human.delay -1: must be from 0 to"),
        ({"human": HumanParams(delay=2**31)}, "human.delay 2147483648: must be from 0 to"),
        ({"human": HumanParams(tolerance=float("inf"))}, "human.tolerance inf: must be a finite"),
    ],
)
def test_hyperparameters_that_cannot_be(change, message):
    hyper = hyper_for(Method.SRL, Hyper(**change))
    with pytest.raises(ValueError, match=re.escape(message)):
        dataclasses.replace(_SPEC, hyper=hyper)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LoopConfig(chunk=0), "chunk 0: must be at least 1"),
        (lambda: LoopConfig(chunk=16.0), "chunk 16.0: must be a whole number"),
        (lambda: LoopConfig(capacity=2**31), "capacity 2147483648: must be at least 32 and at"),
        (lambda: LoopConfig(capacity=10**400), "must be a finite number"),
        (lambda: LoopConfig(updates_per_step=float("nan")), "updates_per_step nan: must be a"),
        (lambda: LoopConfig(updates_per_step=1e300), "updates_per_step 1e+300: must be a finite"),
        (lambda: LoopConfig(updates_per_step=1e9), "must be at least 0 and at most 1000"),
        (lambda: AgentConfig(batch_size=2.0), "batch_size 2.0: must be a whole number"),
        (lambda: AgentConfig(n_step=True), "n_step True: must be a whole number"),
        (lambda: AgentConfig(hidden_sizes=(2.5,)), "hidden_sizes (2.5,): at least one layer"),
        (lambda: AgentConfig(hidden_sizes=(2**40,)), "hidden_sizes 1099511627776: must be at"),
        (
            lambda: batch_arrays.run_keys(2**32, 0),
            "seed 4294967296: must be at least 0 and at most",
        ),
        (lambda: batch_arrays.run_keys(np.int64(-1), 0), "seed -1: must be at least 0"),
        (lambda: batch_arrays.run_keys(0.5, 0), "seed 0.5: must be a whole number"),
        (lambda: num_slots(0, 4), "runs 0: must be at least 1"),
        (lambda: human.delayed(2.5), "max_delay 2.5: must be a whole number"),
        (lambda: make_pool("lean", 2.0), "num_walkers 2.0: must be a whole number"),
    ],
)
def test_what_the_library_is_given_is_checked(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


def test_numbers_of_numpy_are_as_good():
    for whole in (np.int8, np.uint16, np.int64):
        spec = dataclasses.replace(_SPEC, seed=whole(3), episodes=whole(9), snapshots=(whole(2),))
        assert spec == RunSpec(Method.SRL, 3, _SPEC.hyper, 9, (2,))
        assert spec.key.file_name == "srl-seed-0003"
    LoopConfig(capacity=np.int32(2000), updates_per_step=np.float32(0.5))
    require_whole("seed", np.array(3))
    for wrong in (np.array([3]), np.bool_(True), np.float32(3.0), None):
        with pytest.raises(ValueError, match="must be a whole number"):
            require_whole("seed", wrong)
    require("gamma", np.float32(0.5), at_most=1.0)
    with pytest.raises(ValueError, match="must be a finite number"):
        require("gamma", np.bool_(True))


def test_a_delay_that_is_longer_than_the_default_humans_is_a_run():
    hyper = hyper_for(Method.SRL, Hyper(human=HumanParams(delay=60)))
    assert dataclasses.replace(_SPEC, hyper=hyper).hyper.human.delay == 60


def test_more_test_episodes_than_walkers_are_refused():
    evaluator = HostExaminer(make_agent(AgentConfig()), ToyPool(2))
    for seeds in (np.zeros((1, 3), np.uint32), np.zeros((1, 0), np.uint32)):
        with pytest.raises(ValueError, match=r"episodes [03]: must be at least 1 and at most 2"):
            evaluator.evaluate("autonomous", _SPEC.hyper, None, None, None, seeds)


def test_the_readmes_loop_without_an_episode_does_not_begin():
    with pytest.raises(ValueError, match="episodes 0"):
        Rollout(make_agent(AgentConfig()), [dataclasses.replace(_SPEC, episodes=0)], None, None)


_COMMANDS = {
    "sweep": seed_sweep.main,
    "ablation": ablation.main,
    "tuning": tuning.main,
    "agreement": agreement.main,
    "brax-ppo": brax_ppo.main,
}


@pytest.mark.parametrize(
    ("command", "options", "message"),
    [
        ("sweep", "--first-seed 4294967296", "--first-seed 4294967296: must be at least 0 and at"),
        ("sweep", "--first-seed 4294967290 --seeds 7", "--first-seed 4294967290: must be at least"),
        ("sweep", "--first-seed -1", "--first-seed -1: must be at least 0"),
        ("sweep", "--seeds 1000000000000", "--seeds 1000000000000: must be at least 1 and at most"),
        ("sweep", "--episodes 99999999999", "--episodes 99999999999: must be at least 1"),
        ("sweep", "--test-episodes 99999999999", "--test-episodes 99999999999: must be at least"),
        ("sweep", "--capacity 99999999999", "--capacity 99999999999: must be at least 32 and at"),
        ("sweep", "--slots 99999999999", "--slots 99999999999: must be at least"),
        ("sweep", "--workers 99999999999", "--workers 99999999999: must be at least 1"),
        ("sweep", "--warmup-steps 99999999999", "--warmup-steps 99999999999: must be at least 0"),
        ("sweep", "--gamma 1e400", "--gamma inf: must be a finite number"),
        ("ablation", "fading --first-seed 4294967296", "--first-seed 4294967296: must be at"),
        ("ablation", "fading --episodes 0", "--episodes 0: must be at least 1"),
        ("tuning", "--first-seed 4294967295 --seeds 2", "--first-seed 4294967295: must be at"),
        ("tuning", "--ticks 99999999999", "--ticks 99999999999: must be at least 48"),
        ("agreement", "--seed 4294967296", "--seed 4294967296: must be at least 0"),
        ("brax-ppo", "--seed -1", "--seed -1: must be at least 0"),
    ],
)
def test_commands_say_it_before_they_make_a_folder(
    command, options, message, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert run_main(command, _COMMANDS[command], options.split()) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"error: {message}")
    assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_last_seeds_can_be_asked_for():
    options = SweepOptions(first_seed=2**32 - 2, seeds=2).checked()
    assert [spec.seed for spec in options.specs()][-1] == 2**32 - 1
