import dataclasses
import re

import pytest

from hitl_jax.config import AgentConfig, Hyper, Method, RunHyper, hyper_for, validate_hyper
from hitl_jax.human import simulated_human
from hitl_jax.learner.algorithms import LEARNERS
from hitl_jax.team.agent import make_agent


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"learner": "sac"}, "learner sac: must be one of ddpg, td3, td3-tqc"),
        ({"matmul_precision": "float16"}, "matmul_precision float16: must be one of float32"),
        (
            {"matmul_precision": "bfloat16", "hidden_sizes": (64,)},
            "matmul_precision bfloat16: is for products between hidden layers",
        ),
        ({"boundary_source": "oracle"}, "boundary_source oracle: must be one of network"),
        ({"intervention": "shout"}, "intervention shout: must be one of reset"),
        ({"feedback_schedule": "year"}, "feedback_schedule year: must be one of step"),
        ({"indicator": "mood"}, "indicator mood: must be one of hull_angle"),
        ({"danger": "none"}, "danger none: must be one of threshold"),
        ({"hidden_sizes": ()}, "hidden_sizes (): at least one layer"),
        ({"hidden_sizes": (0,)}, "hidden_sizes (0,): at least one layer"),
        ({"hidden_sizes": 8}, "hidden_sizes int 8: must be a tuple of widths"),
        ({"human_parts": "delay"}, "human_parts str 'delay': must be a tuple: each must be one of"),
        ({"n_step": 0}, "n_step 0: must be at least 1"),
        ({"layer_norm": "no"}, "layer_norm no: must be True or False"),
        ({"human_reset_terminates": "false"}, "human_reset_terminates false: must be True or"),
    ],
)
def test_bad_choices_are_named(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        AgentConfig(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delta_minus": -0.001}, "delta_minus -0.001: must be at least 0"),
        ({"gamma": 1.5}, "gamma 1.5: must be at least 0 and at most 1"),
        ({"gamma": float("nan")}, "gamma nan: must be a finite number"),
        (
            {"initial_boundary": 9.0},
            "initial_boundary 9.0: must be at least boundary_low 0 and at most",
        ),
        ({"human_price": 15.0}, "human_price 15.0: must be less than alarm_reward 15"),
        ({"human_price": 14.9999999}, "human_price 14.9999999: must be less than alarm_reward 15"),
        (
            {"human_price": 0.5, "alarm_reward": 0.0},
            "human_price 0.5: must be less than alarm_reward 0",
        ),
        ({"boundary_low": 2.0}, "boundary_high 1.5: must be at least boundary_low 2"),
        ({"takeover_steps": 0}, "takeover_steps 0: must be at least 1"),
        ({"feedback": float("inf")}, "feedback inf: must be a finite number"),
    ],
)
def test_bad_numbers_are_named(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        validate_hyper(dataclasses.replace(Hyper(), **change))


def test_the_defaults_are_valid():
    validate_hyper(Hyper())


def test_lists_become_tuples():
    config = AgentConfig(hidden_sizes=[8, 8], boundary_hidden_sizes=[4], human_parts=["delay"])
    same = AgentConfig(hidden_sizes=(8, 8), boundary_hidden_sizes=(4,), human_parts=("delay",))
    assert config == same
    assert hash(config) == hash(same)
    assert make_agent(config) == make_agent(same)
    assert simulated_human(parts=["delay"]) is simulated_human(parts=("delay",))


def test_methods_share_everything_but_their_flags():
    made = {method: dataclasses.asdict(hyper_for(method, Hyper(gamma=0.9))) for method in Method}
    flags = {field.name for field in dataclasses.fields(RunHyper)} - {
        field.name for field in dataclasses.fields(Hyper)
    }
    for method, values in made.items():
        assert values["gamma"] == 0.9
        different = {name for name in values if values[name] != made[Method.HITL_AC][name]}
        assert different <= flags, method
    assert made[Method.SRL]["has_arbiter"] == 0.0
    assert made[Method.HITL_FIX]["has_arbiter"] == 1.0
    assert made[Method.HITL_FIX]["learns_boundary"] == 0.0


def test_what_the_learners_are():
    named = {
        name: (of.num_critics, of.policy_delay, of.smooths_target, of.num_quantiles)
        for name in LEARNERS
        for of in [AgentConfig(learner=name).task_learner]
    }
    assert named == {
        "ddpg": (1, 1, False, None),
        "td3": (2, 2, True, None),
        "td3-tqc": (2, 2, True, 10),
    }
