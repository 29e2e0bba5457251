"""What made results and what is here now: told by name, in one line."""

import pathlib

import numpy as np
import pytest
from example_results import CONFIG, KEY, make_episodes, make_info, make_params, make_tests
from example_saves import make_saved

from hitl_jax.boundary.margin import MARGIN_PARTS
from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.playback import episodes
from hitl_jax.results import config_diff
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.provenance import origin
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep import autosave
from hitl_jax.sweep.autosave import UnderWay
from hitl_jax.sweep.launchers import local
from hitl_jax.sweep.train_and_test import Batch, Walkers
from hitl_jax.training.run_spec import LoopConfig, RunSpec
from hitl_jax.training.saved_run import CannotReturn
from hitl_jax.training.saved_run_store import Saves

_NOW = {
    "commit": "c" * 40,
    "processor": "Zen 5",
    "versions": {"python": "3.13.1", "jax": "0.12.0", "numpy": "2.4", "box2d": "2.3.10"},
}


@pytest.mark.parametrize(
    ("made", "told"),
    [
        ({}, []),
        (_NOW, []),
        ({"versions": {}}, []),
        ({"versions": _NOW["versions"] | {"jax": "0.10.2"}}, ["jax 0.10.2, now 0.12.0"]),
        ({"versions": {"box2d-py": "2.3.5"}}, ["box2d-py 2.3.5, now none"]),
        ({"versions": {"numpy": "2.3", "python": "3.11"}}, ["numpy 2.3", "python 3.11"]),
        ({"processor": "Xeon"}, ["processor Xeon, now Zen 5"]),
        ({"commit": "a" * 40}, ["commit aaaaaaa, now ccccccc"]),
        ({"commit": None}, ["commit unknown, now ccccccc"]),
    ],
)
def test_only_what_differs_is_told(made, told):
    found = config_diff.changes(made, _NOW)
    assert len(found) == len(told)
    for line, begins in zip(found, told, strict=True):
        assert line.startswith(begins)


@pytest.mark.parametrize(
    ("agent", "parts"),
    [
        ({"boundary_learner": "printed"}, MARGIN_PARTS),
        ({"boundary_learner": "printed", "margin_parts": ["often"]}, ["often"]),
        ({}, MARGIN_PARTS),
        ({"boundary_learner": "margin"}, MARGIN_PARTS[:-3]),
        ({"boundary_learner": "margin", "margin_parts": ["often"]}, ["often"]),
        ({"boundary_learner": "my_team:mine", "margin_parts": ["often"]}, ["often"]),
    ],
)
def test_parts_that_came_later_were_not_in_what_was_kept(agent, parts):
    found = config_diff.completed({"agent": agent})["agent"]["margin_parts"]
    assert found == list(parts)


@pytest.mark.parametrize(
    ("learner", "differ"), [("printed", False), ("margin", True), ("my_team:mine", True)]
)
def test_parts_are_compared_where_they_mean_something(learner, differ):
    one, other = (
        {"agent": {"boundary_learner": learner, "margin_parts": parts}}
        for parts in (["often"], list(MARGIN_PARTS))
    )
    assert (config_diff.compared(one) != config_diff.compared(other)) == differ


def test_parts_that_one_side_lacks_are_not_told():
    parts = list(MARGIN_PARTS)
    one, other = (
        {"agent": {"boundary_learner": learner, "margin_parts": parts}}
        for learner in ("printed", "margin")
    )
    with pytest.raises(config_diff.ConfigMismatch) as caught:
        config_diff.require_same(pathlib.Path("a"), one, other)
    assert "margin_parts" not in str(caught.value)


def test_versions_of_several_sittings_are_all_kept():
    first, second = {"jax": "0.10.2", "numpy": "2.4"}, {"jax": "0.12.0", "numpy": "2.4"}
    assert config_diff.joined({}, first) == first
    both = config_diff.joined(first, second)
    assert both == {"jax": "0.10.2, then 0.12.0", "numpy": "2.4"}
    assert config_diff.joined(both, second) == both
    assert config_diff.joined(both, first)["jax"] == "0.10.2, then 0.12.0, then 0.10.2"
    assert config_diff.joined({"brax": "0.14"}, {"jax": "0.12"}) == {
        "brax": "0.14, then none",
        "jax": "none, then 0.12",
    }


@pytest.mark.parametrize("name", ["jax", "numpy", "gymnasium", "python", "machine"])
def test_runs_of_other_versions_are_told_before_they_are_played(name, tmp_path):
    here = origin()
    made = {"versions": dict(here["versions"]), "commit": here["commit"]}
    made["machine"] = f"{here['processor']}, 3 cores"
    if name == "machine":
        made["machine"] = "Xeon, with a large cache, 2 cores"
        told = f"processor Xeon, with a large cache, now {here['processor']}"
    else:
        made["versions"][name] = "0.0.1"
        told = f"{name} 0.0.1, now {here['versions'][name]}"
    folder = ResultsFolder(tmp_path)
    folder.create_or_resume(CONFIG, "command")
    keys = [KEY, RunKey("srl", 0)]
    for key in keys:
        folder.save_run(key, make_episodes(), make_tests(), make_params(), make_info(**made))
    said = episodes.differences(folder, keys)
    assert said.startswith(f"{tmp_path} was made with {told}: numbers can differ")
    assert "\n" not in said
    assert said.count("was made with") == 1


def test_a_run_keeps_the_versions_of_all_its_sittings(tmp_path, monkeypatch):
    class Stopped:
        def __init__(self, ticks):
            self.ticks = ticks

        def save(self):
            return [make_saved(self.ticks, 4, KEY)]

    for ticks, version in ((4, "0.10.2"), (8, "0.12.0")):
        monkeypatch.setattr(autosave, "versions", lambda now=version: {"jax": now})
        saves = UnderWay(tmp_path, 8, seconds=0.0)
        saves.take({KEY}, (), print)
        saves.watch(Stopped(ticks))
    assert saves.changes() == ["jax 0.10.2, now 0.12.0"]
    assert saves.versions_of(KEY) == {"jax": "0.10.2, then 0.12.0"}
    [again] = Saves(tmp_path, 8).load()[0].values()
    assert again.facts["versions"] == {"jax": "0.10.2, then 0.12.0"}


def test_a_run_that_cannot_go_on_names_the_versions(tmp_path, monkeypatch):
    def refuse(*_):
        raise CannotReturn("1 of 1 walkers did not come back as they were")
        yield

    saved = make_saved(4, 4, KEY)
    versions = origin()["versions"]
    facts = saved.facts | {"versions": versions | {"gymnasium": "1.0", "numpy": np.__version__}}
    Saves(tmp_path / "batch", 8).write([saved._replace(facts=facts)])
    monkeypatch.setattr(local, "train_and_test", refuse)
    spec = RunSpec(Method.HITL_AC, KEY.seed, hyper_for(Method.HITL_AC, Hyper()), episodes=1)
    batch = Batch("batch", None, [spec], LoopConfig(), Walkers("lean", 2, 1, 1))
    makes = local.Local(tmp_path, 60.0, lambda: (), lambda _: None)
    with pytest.raises(CannotReturn) as caught:
        next(makes.make([batch], lambda _: None))
    assert str(caught.value) == (
        "1 of 1 walkers did not come back as they were; saved with gymnasium 1.0, now "
        f"{versions['gymnasium']}"
    )
