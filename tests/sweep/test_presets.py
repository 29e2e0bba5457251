"""A preset's options stand in the defaults' place, and what is given goes before them."""

import dataclasses
import re

import pytest

from hitl_jax.console.cli import BadInput, checking_input, parse
from hitl_jax.errors import InvalidValue
from hitl_jax.sweep.changes import changed
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.sweep.presets import HUMAN_PRESETS, IDEAL, PAPER, PRESETS


def test_the_paper_s_options_are_taken_where_none_is_given():
    options = parse(SweepOptions, ["--preset", "paper"]).checked()
    assert options == SweepOptions.of_preset("paper")
    assert (options.agent.learner, options.agent.intervention) == ("ddpg", "reset")
    assert options.agent.boundary_source == "rule"
    assert (options.hyper.feedback, options.hyper.delta_plus) == (-20.0, 0.001)
    assert options.scale().episodes == 1000


def test_what_is_given_goes_before_the_preset():
    """Also where it is the usual default."""
    usual = SweepOptions()
    words = ["--learner", usual.agent.learner, "--feedback", "-3", "--human.delay", "5"]
    words += ["--episodes", "7", "--seeds", "2"]
    for place in (0, len(words)):
        options = parse(SweepOptions, [*words[:place], "--preset", "paper", *words[place:]])
        assert options.agent == dataclasses.replace(
            changed(PAPER).agent, learner=usual.agent.learner
        )
        assert (options.hyper.feedback, options.hyper.human.delay) == (-3.0, 5)
        assert (options.scale().episodes, options.scale().seeds) == (7, 2)
        assert options.scale().test_episodes == PRESETS["paper"].test_episodes


@pytest.mark.parametrize("words", [["--preset=paper"], ["--preset", "quick", "--preset", "paper"]])
def test_the_last_preset_counts_however_it_is_written(words):
    assert parse(SweepOptions, words) == SweepOptions.of_preset("paper")


@pytest.mark.parametrize("preset", PRESETS)
def test_what_a_preset_says_of_the_human_is_not_refused_beside_a_file(preset, tmp_path):
    own = ["--preset", preset, "--human-policy", str(tmp_path / "params.npz")]
    assert parse(SweepOptions, own).checked().preset == preset
    recorded = ["--preset", preset, "--human", f"recorded:{tmp_path / 'human.json'}"]
    assert parse(SweepOptions, recorded).checked().preset == preset
    with pytest.raises(InvalidValue, match=r"^human_actions"):
        parse(SweepOptions, [*own, "--human-actions", "still"]).checked()
    with pytest.raises(InvalidValue, match=r"^danger"):
        parse(SweepOptions, [*recorded, "--danger", "predictive"]).checked()


@pytest.mark.parametrize(
    "words",
    [
        ["--human-preset", "ideal"],
        ["--human_preset=ideal"],
        ["--human-preset", "person", "--preset", "full", "--human-preset", "ideal"],
    ],
)
def test_a_human_preset_changes_the_human_alone(words):
    options = parse(SweepOptions, words).checked()
    expected = changed(IDEAL)
    assert (options.agent, options.hyper) == (expected.agent, expected.hyper)
    assert options.agent.learner == SweepOptions().agent.learner


def test_a_person_beside_the_paper_s_learner():
    options = parse(SweepOptions, ["--preset", "paper", "--human-preset", "person"]).checked()
    usual, paper = SweepOptions(), SweepOptions.of_preset("paper")
    assert options.hyper.human == usual.hyper.human != paper.hyper.human
    assert options.hyper.feedback == usual.hyper.feedback
    assert options.agent.human_actions == usual.agent.human_actions
    assert options.agent.learner == paper.agent.learner


def test_what_is_given_goes_before_the_human_preset():
    words = ["--human-preset", "ideal", "--human.delay", "10", "--feedback", "-50"]
    options = parse(SweepOptions, words).checked()
    assert (options.hyper.human.delay, options.hyper.feedback) == (10, -50.0)
    assert options.agent.intervention == "reset"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("human", HUMAN_PRESETS)
def test_every_two_presets_can_be_made(preset, human):
    options = SweepOptions.of_preset(preset, human).checked()
    assert (options.preset, options.human_preset) == (preset, human)
    same = human in ("preset", "ideal" if preset == "paper" else "person")
    assert same == (options.hyper == SweepOptions.of_preset(preset).hyper)


def test_a_human_preset_is_refused_beside_a_file(tmp_path):
    words = ["--human", f"recorded:{tmp_path / 'human.json'}", "--human-preset", "person"]
    with pytest.raises(InvalidValue, match=r"^human_preset person: has no meaning beside human"):
        parse(SweepOptions, words).checked()


def test_srl_has_nothing_to_learn_from_without_the_task_s_reward():
    words = ["--reward-weight", "0"]
    with pytest.raises(InvalidValue, match=r"^reward_weight 0: leaves srl nothing to learn from"):
        parse(SweepOptions, words).checked()
    parse(SweepOptions, [*words, "--methods", "hitl-fix", "hitl-ac"]).checked()


def test_help_shows_the_preset_s_defaults(capsys):
    with pytest.raises(SystemExit):
        parse(SweepOptions, ["--preset", "paper", "--help"])
    assert "(default: ddpg)" in re.sub(r"[│\s]+", " ", capsys.readouterr().out)


def test_a_preset_without_changes_is_a_size():
    assert parse(SweepOptions, ["--preset", "quick"]) == SweepOptions(preset="quick")
    assert parse(SweepOptions, []) == SweepOptions()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--preset", "best"], "--preset best: must be one of full, quick, paper"),
        (["--preset"], "--preset: a value is missing"),
        (["--human-preset", "kind"], "--human-preset kind: must be one of preset, person, ideal"),
        (["--human-preset", "None"], "--human-preset None: must be one of preset, person, ideal"),
        (["--human-preset"], "--human-preset: a value is missing"),
        (["--preset", "paper", "--gamma", "2"], "--gamma 2.0: must be at least 0 and at most 1"),
        (["--preset", "paper", "--gama", "1"], "Unrecognized options: --gama"),
        (["--preset", "paper", "--feedback", "much"], "--feedback much"),
    ],
)
def test_bad_input_is_told_as_without_a_preset(words, told):
    with pytest.raises(BadInput, match=f"^{told}"), checking_input():
        parse(SweepOptions, words).checked()


def test_every_preset_can_be_made():
    for name in PRESETS:
        assert SweepOptions.of_preset(name).checked().preset == name
