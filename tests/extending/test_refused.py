"""What does not do what its protocol says is one line when the team is made, not in mid-run."""

import dataclasses

import bad_team
import jax.numpy as jnp
import pytest
from paper_team import paper_config

from hitl_jax import human
from hitl_jax.boundary import BoundarySource
from hitl_jax.config import RunHyper
from hitl_jax.errors import InvalidValue
from hitl_jax.team import acting
from hitl_jax.team.agent import make_agent
from hitl_jax.xla.threefry import make_key

_CONFIG = paper_config(learner="ddpg", hidden_sizes=(8,), boundary_hidden_sizes=(4,), batch_size=8)
_BATTERY = "raised RuntimeError: no battery"

_REFUSED = [
    ("indicator", "of_two", "raised TypeError: of_two() missing 1 required positional argument"),
    ("indicator", "branching", "raised TracerBoolConversionError: "),
    ("indicator", "text", "raised TypeError: "),
    ("indicator", "raises", _BATTERY),
    ("danger", "a_number", "must give one truth value, gives float32[]"),
    ("danger", "three_truths", "must give one truth value, gives bool[24]"),
    ("danger", "unknown_option", "raised KeyError: 'nowhere'"),
    ("danger", "forgetful", "raised ValueError: state of the human: a leaf was int32[]"),
    ("danger", "of_four_bits", "raised ValueError: a leaf of type int4: must have 8, 16 or 32"),
    ("human_actions", "one_action", "must give 4 actions, gives float32[5]"),
    ("human_actions", "asks", "raised KeyError: 'battery'"),
    ("boundary_source", "counting", "int32[2]: must be float32, [] or [K]"),
    ("boundary_source", "remembering", "dict: must be float32, [] or [K]"),
    ("boundary_source", "three_boundaries", "must give one number, gives float32[3]"),
    ("boundary_source", "plain_option", "options tuple: must be a tuple of Option"),
    ("boundary_source", "no_default", "default of option drift nan: must be a finite number"),
    ("boundary_source", "beyond_its_bounds", "default of option drift 5.0: must be at least 0"),
    ("intervention", "without_ruling", "must give (state, Ruling), gives tuple"),
    ("intervention", "leaves", "raised SystemExit: 0"),
    ("release", "keeps_two", "must give one truth value, gives bool[2]"),
    ("feedback_schedule", "once", "raised TypeError: once() takes 1 positional argument"),
    ("feedback_schedule", "how_often", "must give a truth value for each step, gives int 3"),
    ("feedback_schedule", "nowhere", "bad_team has no nowhere"),
    ("learner", "raises", _BATTERY),
    ("learner", "slashed", "metric 'loss/Critic': must begin with a to z"),
    ("learner", "counter", "metric 'env_steps': must begin with a to z"),
    ("learner", "of_the_boundary", "metric 'network_boundary': is a name for the boundary"),
    ("learner", "of_each", "metric 'q_of_each': must be a number, is tuple"),
    ("learner", "no_metrics", "improve must give (state, metrics), gives LearnerState"),
    ("learner", "two_actions", "must give 4 actions, gives float32[2]"),
    ("learner", "never_last", "policy_delay 0: must be at least 1"),
    ("learner", "half_last", "policy_delay 1.5: must be a whole number"),
    ("learner", "no_hash", "must be hashable"),
]


@pytest.mark.parametrize(("option", "name", "why"), _REFUSED)
def test_the_choice_at_fault_is_named(option, name, why):
    with pytest.raises(InvalidValue, match=f"^{option} bad_team:{name}: ") as caught:
        make_agent(dataclasses.replace(_CONFIG, **{option: f"bad_team:{name}"}))
    assert why in str(caught.value)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_a_part_of_the_human_is_named_apart_from_the_danger():
    config = dataclasses.replace(_CONFIG, human_parts=("delay", "bad_team:a_number"))
    with pytest.raises(InvalidValue, match=r"^human_parts bad_team:a_number: must give one truth"):
        make_agent(config)


class _Nothing:
    pass


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"judge": 3}, "judge int 3: must be a HumanPart"),
        ({"judge": "predictive"}, "judge str 'predictive': must be a HumanPart"),
        ({"judge": human.predictive}, "judge predictive: must be a HumanPart"),
        ({"judge": ()}, "judge tuple: must be a HumanPart"),
        ({"judge": bad_team.a_number()}, "judge HumanPart: must give one truth value"),
        ({"judge": bad_team.a_number()._replace(options=[])}, "judge HumanPart: options list"),
        ({"learner": 0}, "learner int 0: must be one of ddpg"),
        ({"learner": ""}, "learner : must be one of ddpg"),
        ({"learner": _Nothing}, "learner _Nothing: raised TypeError"),
        ({"source": bad_team.of_two}, "human_actions of_two: raised TypeError"),
        ({"source": bad_team.raises}, f"human_actions raises: {_BATTERY}"),
        ({"release": bad_team.raises}, f"release raises: {_BATTERY}"),
        ({"indicator": _Nothing}, "indicator _Nothing: must give a safety indicator"),
        ({"intervention": bad_team.counting()}, "intervention BoundarySource: must be one of"),
    ],
)
def test_an_object_that_is_none_of_its_kind_is_one_line(given, said):
    with pytest.raises(InvalidValue) as caught:
        make_agent(_CONFIG, **given)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


@pytest.mark.parametrize("first", [0.5, jnp.zeros(3)])
def test_a_boundary_source_may_begin_with_plain_numbers(first):
    source = BoundarySource(
        init=lambda tau: first, boundary=lambda carry, network: network, advance=_same
    )
    agent = make_agent(_CONFIG, boundary_source=source)
    state = acting.init_acting(agent, RunHyper(), make_key(0))
    assert (state.boundary.dtype, state.boundary.shape) == (jnp.float32, jnp.shape(first))


def _same(carry, move):
    return carry


def test_an_equal_team_is_tried_once():
    traced = []

    def indicator(observation):
        traced.append(observation)
        return observation[0]

    make_agent(_CONFIG, indicator=indicator)
    before = len(traced)
    make_agent(_CONFIG, indicator=indicator)
    assert len(traced) == before > 0


def test_an_indicator_sees_no_numbers_and_so_has_no_options():
    def leaning(observation):
        return observation[0]

    leaning.options = (bad_team.Option("lean", 0.1, "how far"),)
    assert "lean" not in make_agent(_CONFIG, indicator=leaning).options
