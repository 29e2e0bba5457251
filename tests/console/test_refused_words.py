"""A bad command line is a line with the option, the value and what is allowed."""

import pytest

from hitl_jax.commands.figures import Options
from hitl_jax.console.cli import BadInput, parse
from hitl_jax.sweep.options import SweepOptions


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--layer-norm maybe", "--layer-norm maybe: takes no value; --no-layer-norm is its opp"),
        ("--seeds 1 --layer_norm=maybe", "--layer-norm maybe: takes no value; --no-layer-norm is"),
        ("--no-layer-norm x y", "--no-layer-norm x: takes no value; --layer-norm is its opposite"),
        ("--seeds 1 2 --episodes 3", "--seeds 1 2: 2 is a word too many"),
        ("stray", "Unrecognized options: stray"),
        ("--nosuch 3", "Unrecognized options: --nosuch, 3"),
        ("--seeds 1 1", "Unrecognized options: 1"),  # Which of the two cannot be told.
        ("--extra drift", "--extra drift: must be pairs of a name and a number"),
        ("--extra drift abc", "--extra drift abc: must be pairs of a name and a number"),
        ("--extra a 1 b --seeds 2", "--extra a 1 b: must be pairs of a name and a number"),
        ("--human.extra=ahead", "--human.extra ahead: must be pairs of a name and a number"),
        ("--hidden-sizes 8 a", "--hidden-sizes 8 a: must be whole numbers"),
        ("--seeds many", "--seeds many: must be a whole number"),
        ("--gamma half", "--gamma half: must be a number"),
        ("--gamma", "--gamma: a value is missing"),
        ("--seeds 2 --gamma", "--gamma: a value is missing"),
        ("--no-layer-norm --seeds 2 3", "--no-layer-norm --seeds 2 3: 3 is a word too many"),
    ],
)
def test_the_option_is_named(words, told):
    with pytest.raises(BadInput) as caught:
        parse(SweepOptions, words.split())
    assert str(caught.value).startswith(told)


def test_an_option_in_the_place_of_a_value():
    with pytest.raises(BadInput, match=r"^--human.mistake-rate(: a v| --seeds 2: 2 is a word t)"):
        parse(SweepOptions, ["--human.mistake-rate", "--seeds", "2"])


def test_a_word_after_the_folder():
    with pytest.raises(BadInput, match=r"^--no-diagnostics a b: b is a word too many$"):
        parse(Options, ["--no-diagnostics", "a", "b"])
