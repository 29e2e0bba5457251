"""Errors of values: names and values in the library, options on the command line."""

import pickle

import pytest

from hitl_jax.choices import checks
from hitl_jax.config import Hyper, validate_hyper
from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.errors import InvalidValue
from hitl_jax.human.judgement import HumanParams
from hitl_jax.training.run_spec import LoopConfig

_REFUSED = [
    (lambda: checks.require("gamma", 1.5, at_most=1.0), "gamma 1.5: must be at most 1"),
    (lambda: checks.require_whole("n_step", 0.5), "n_step 0.5: must be a whole number"),
    (lambda: checks.one_of("learner", "", ("ddpg",)), "learner : must be one of ddpg"),
    (
        lambda: validate_hyper(Hyper(human=HumanParams(mistake_rate=2.0))),
        "human.mistake_rate 2.0: must be from 0 to 1",
    ),
    (
        lambda: LoopConfig(updates_per_step=0.3).num_updates(1),
        "updates_per_step 0.3: times chunk 16 it must be a multiple of 1",
    ),
]
_OPTIONS = [
    "--gamma 1.5: must be at most 1",
    "--n-step 0.5: must be a whole number",
    "--learner : must be one of ddpg",
    "--human.mistake-rate 2.0: must be from 0 to 1",
    "--updates-per-step 0.3: times --chunk 16 it must be a multiple of 1",
]


@pytest.mark.parametrize(("check", "text"), _REFUSED)
def test_the_library_names_the_value(check, text):
    with pytest.raises(InvalidValue) as caught:
        check()
    assert str(caught.value).startswith(text)
    assert str(pickle.loads(pickle.dumps(caught.value))).startswith(text)  # Between machines.


@pytest.mark.parametrize(("refused", "text"), list(zip(_REFUSED, _OPTIONS, strict=True)))
def test_the_console_names_the_option(refused, text):
    with pytest.raises(BadInput) as caught, checking_input():
        refused[0]()
    assert str(caught.value).startswith(text)


def test_a_name_that_says_enough_stands_alone():
    error = InvalidValue("danger", ..., "has no meaning in mode test", mentions=("mode",))
    assert str(error) == "danger: has no meaning in mode test"
    assert error.text("--{}".format) == "--danger: has no meaning in --mode test"
