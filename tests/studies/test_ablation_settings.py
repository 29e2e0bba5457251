"""What ablations compare, and that what is kept of them is what they ask for."""

import dataclasses
import pathlib

import pytest

from hitl_jax.config import AgentConfig, Hyper
from hitl_jax.errors import InvalidValue
from hitl_jax.playback.load_trained import section_of
from hitl_jax.results import episode_tables
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.studies.ablations import runs
from hitl_jax.studies.ablations.options import AblationOptions
from hitl_jax.studies.ablations.settings import ABLATIONS, BASE, Budget
from hitl_jax.studies.ablations.store import RunId, Store, digest
from hitl_jax.sweep.changes import changed

_KEPT = pathlib.Path(__file__).parents[2] / "results" / "ablations" / "runs.csv"


def test_every_setting_can_be_made_and_has_a_label_of_its_own():
    for one in ABLATIONS.values():
        labels = [setting.label for setting in one.settings]
        assert len(set(labels)) == len(labels)
        assert not any("|" in label for label in labels)  # They stand in a Markdown table.
        for setting in one.settings:
            changed(BASE | setting.changes)
            assert len(setting.name) <= episode_tables._LONGEST_CELL


def test_a_name_that_is_none_is_refused():
    with pytest.raises(InvalidValue, match=r"^name sleep: must be one of exploration, fading"):
        AblationOptions("sleep").checked()


def test_an_ablation_is_run_as_its_kept_table_was():
    """But for what is asked for."""
    fading = ABLATIONS["fading"]
    assert AblationOptions("fading").chosen() == {"fading": fading}
    assert fading.budget == Budget(10, 100, 400, 100)
    asked = AblationOptions("fading", first_seed=0, test_episodes=5).chosen()
    assert asked["fading"].budget == Budget(10, 0, 400, 5)
    assert list(AblationOptions("all").chosen()) == list(ABLATIONS)


def test_the_help_names_every_ablation():
    assert not [name for name in ABLATIONS if name not in AblationOptions.__doc__]


def test_a_misspelt_option_is_not_passed_over():
    with pytest.raises(ValueError, match="btach_size"):
        changed({"btach_size": 1})


def test_digests_tell_options_and_budgets_apart():
    budget = {"episodes": 3}
    digests = [
        digest(changed({}), budget),
        digest(changed({"gamma": 0.9}), budget),
        digest(changed({"delay": 5}), budget),
        digest(changed({}), {"episodes": 4}),
    ]
    assert len(set(digests)) == 4
    assert digest(changed({}), budget) == digests[0]


def test_the_digest_of_kept_runs_is_the_same():
    """Who adds an option adds it to `CAME_LATER`; who changes a default pins it in `BASE`."""
    made = [
        digest(
            changed(BASE | ABLATIONS["loophole"].settings[3].changes),
            {"episodes": 300, "test_episodes": 20},
        ),
        digest(
            changed(BASE | ABLATIONS["initial-boundary"].settings[3].changes),
            {"episodes": 160, "test_episodes": 100},
        ),
    ]
    assert made == ["a4a82c26204d", "4c0ef5836bf1"]
    kept = Store(_KEPT).keys()
    assert set(made) <= {key.setting for key in kept}


def test_equal_settings_of_two_names_are_one_run():
    """A store finds a run by what defines its numbers, however the setting was written."""
    parts = changed(BASE)
    kept = RunId("", "srl", 0, digest(parts, {}))
    assert kept == RunId(
        "feedback=-20.0", "srl", 0, digest(changed(BASE | {"feedback": -20.0}), {})
    )
    assert kept != RunId("", "srl", 0, digest(changed(BASE | {"feedback": -5.0}), {}))


def test_every_kept_run_is_shown_by_the_report():
    kept = Store(_KEPT).keys()
    shown = {
        run.key
        for ablation in ABLATIONS.values()
        for setting, parts in runs.settings_of(ablation)
        for run in runs.runs_of(ablation, setting, parts)
    }
    assert not kept - shown


def test_values_that_are_not_allowed_are_refused():
    with pytest.raises(ValueError, match="delay 40: must be from 0 to 32"):
        changed({"delay": 40})


@pytest.mark.parametrize(
    ("name", "label"),
    [("initial-boundary", "0.7 (default)"), ("loophole", "the default")],
)
def test_the_default_is_a_setting(name, label):
    [setting] = [one for one in ABLATIONS[name].settings if one.label == label]
    assert changed(BASE | setting.changes) == changed({})


def test_the_ablation_of_the_boundary_learner_starts_from_what_is_kept():
    kept = ResultsFolder(pathlib.Path(__file__).parents[2] / "results" / "foresight_120")
    agent, hyper = (section_of(kept, *one) for one in (("agent", AgentConfig), ("hyper", Hyper)))
    assert hyper.human.delay == 0  # Today's human reacts later.
    today = hyper.human.replace(delay=Hyper().human.delay, extra={})
    hyper = dataclasses.replace(hyper, human=today)
    whole = ABLATIONS["boundary-parts"].settings[0]
    parts = changed(BASE | whole.changes)
    assert (parts.agent, parts.hyper) == (agent, hyper)
