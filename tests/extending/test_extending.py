"""One choice of each kind from outside the package: by name, as objects, and bad ones."""

import csv
import dataclasses
import json
import re
import sys

import jax
import my_sac
import my_team
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.choices.fields import require_fields, whole
from hitl_jax.choices.registry import TRUSTED, Registry
from hitl_jax.commands import alarms
from hitl_jax.commands.seed_sweep import main
from hitl_jax.config import AgentConfig, Hyper, Method, RunHyper, hyper_for
from hitl_jax.console.cli import run_main
from hitl_jax.envs import BACKENDS
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.human import HumanParams, chain, delayed
from hitl_jax.playback import load_trained
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.team import agent as agents
from hitl_jax.team.agent import make_agent
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import LoopConfig, RunSpec

_SMALL = {
    "observation_size": 3,
    "action_size": 1,
    "hidden_sizes": (8,),
    "batch_size": 8,
    "tested_actor": "average",
}
_CONFIG = paper_config(
    learner="my_sac:sac",
    boundary_source="my_team:drifting",
    indicator="my_team:tilt",
    danger="my_team:steep",
    human_parts=("delay", "my_team:startled"),
    human_actions="my_team:hand",
    intervention="my_team:patient",
    **_SMALL,
)
_LOOP = LoopConfig(capacity=400)
_HYPER = paper_hyper(
    warmup_steps=40,
    initial_boundary=0.3,
    extra={"drift": 0.002},
    human=HumanParams(delay=0, extra={"ahead": 1.0}),
)


@pytest.fixture
def words():
    """The options of a sweep with one choice of each kind."""
    return [
        *(
            "--preset",
            "paper",
            "--seeds",
            "1",
            "--methods",
            "hitl-ac",
            "--episodes",
            "4",
            "--test-episodes",
            "1",
        ),
        *("--backend", "my_team:poles", "--observation-size", "3", "--action-size", "1"),
        *("--learner", "my_sac:sac", "--hidden-sizes", "8", "--batch-size", "8"),
        *("--tested-actor", "average"),
        *("--boundary-source", "my_team:drifting", "--indicator", "my_team:tilt"),
        *("--danger", "my_team:steep", "--human-parts", "delay", "my_team:startled"),
        *("--human-actions", "my_team:hand", "--intervention", "my_team:patient"),
        *("--initial-boundary", "0.3", "--warmup-steps", "40", "--capacity", "400"),
        *("--extra", "drift", "0.002", "--human.extra", "ahead", "1"),
    ]


def _train(agent):
    specs = [RunSpec(Method.HITL_AC, 0, hyper_for(Method.HITL_AC, _HYPER), episodes=4)]
    with BACKENDS.make(my_team.Poles, num_walkers=2) as pool:
        [finished] = [one for done in Rollout(agent, specs, pool, _LOOP) for one in done]
    return finished


@pytest.fixture(scope="module")
def by_name():
    return _train(make_agent(_CONFIG))


def test_named_on_the_command_line(words, by_name, tmp_path, monkeypatch):
    out = tmp_path / "mine"
    assert run_main("sweep", main, [*words, "--out", str(out)]) == 0
    folder = ResultsFolder(out)
    run = folder.load_run(RunKey("hitl-ac", 0))
    assert run.episodes["return"].tolist() == [row["return"] for row in by_name.run.episodes]
    assert run.info["updates"] > 0
    config = json.loads((out / "config.json").read_text())["config"]
    assert config["agent"]["learner"] == "my_sac:sac"
    assert config["hyper"]["extra"] == {"drift": 0.002, "patience": 1.0, "temperature": 0.1}
    # What somebody's folder names is code: it is run where its reader says so.
    said = f"config.json: names code that would be run: learner my_sac:sac.*{TRUSTED}=my_sac"
    with pytest.raises(ResultsError, match=said):
        load_trained.agent_of(folder)
    assert run_main("alarms", alarms.main, [str(out)]) == 2
    monkeypatch.setenv(TRUSTED, "my_sac, my_team")
    assert load_trained.agent_of(folder).learner == my_sac.sac(_CONFIG)
    # Then its own pool plays it again.
    assert run_main("alarms", alarms.main, [str(out), "--episodes", "1"]) == 0
    with (out / "alarms.csv").open(encoding="utf-8") as rows:
        steps = {row["steps"] for row in csv.DictReader(rows)}
    assert steps == {str(run.tests["length"][run.tests["mode"] == "autonomous"].sum())}


def test_each_has_its_part(by_name):
    rows = by_name.run.episodes
    assert len(rows) == 4 and by_name.run.updates > 0
    steps = sum(row["length"] for row in rows)
    # It falls at every step, and stops at the least boundary.
    np.testing.assert_allclose(by_name.boundary, max(0.3 - 0.002 * steps, 0.05), rtol=1e-4)
    assert sum(row["alarms"] for row in rows) > 0
    assert isinstance(by_name.train.learner, my_sac.SacState)


def test_objects_from_python_do_the_same(by_name):
    plain = paper_config(**_SMALL)
    mine = _train(
        make_agent(
            plain,
            indicator=my_team.tilt,
            judge=chain(my_team.steep(), delayed(), my_team.startled()),
            source=my_team.hand(1),
            learner=my_sac.sac(plain),
            boundary_source=my_team.drifting(),
            intervention=my_team.patient(),
        )
    )
    assert repr(mine.run.episodes) == repr(by_name.run.episodes)
    jax.tree.map(np.testing.assert_array_equal, mine.train, by_name.train)


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("learner", "no_such_module:sac", "no_such_module cannot be imported: ModuleNotFoundError"),
        ("learner", "my_sac:dqn", "my_sac has no dqn"),
        ("learner", "my_team:of_another_kind", "raised TypeError: of_another_kind("),
        ("danger", "my_team:broken", "raised ValueError: its file"),
        ("danger", "my_team:of_another_kind", "must give a danger model, gives int 3"),
        ("boundary_source", "my_team:steep", "must give a boundary source, gives HumanPart"),
        ("intervention", "my_team:drifting", "must give an intervention, gives BoundarySource"),
        ("human_actions", "my_team:np", "must be one of still, scripted, trained, "),
        ("indicator", "my_team:two_numbers", "must give one number"),
    ],
)
def test_bad_ones_are_one_line(name, value, why):
    changes = {name: value}
    with pytest.raises(InvalidValue, match=f"^{name} {value}: ") as caught:
        make_agent(dataclasses.replace(_CONFIG, **changes))
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--learner", "dqn"], "--learner dqn: must be one of ddpg, td3, td3-tqc, or module:name"),
        (["--learner", "my_sac:dqn"], "--learner my_sac:dqn: my_sac has no dqn"),
        (["--human-parts", "delay", "mood"], "--human-parts mood: must be one of delay, mistakes"),
        (["--human-parts", "delay", "delay"], "--human-parts delay delay: each at most once"),
        (["--feedback-schedule", "nosuch:it"], "--feedback-schedule nosuch:it: nosuch cannot be"),
        (["--learner", "bad_team:slashed"], "--learner bad_team:slashed: metric 'loss/Critic'"),
        (["--learner", "bad_team:never_last"], "--learner bad_team:never_last: policy_delay 0"),
        (["--indicator", "bad_team:leaves"], "--indicator bad_team:leaves: raised SystemExit: 0"),
        (["--backend", "bad_team:raises"], "--backend bad_team:raises: raised RuntimeError: no"),
        (["--backend", "my_team:nobody"], "--backend my_team:nobody: my_team has no nobody"),
        (["--extra", "drift", "0.2"], "--extra.drift 0.2: must be at least 0 and at most 0.1"),
        (["--extra", "drift", "nan"], "--extra.drift nan: must be a finite number"),
        (["--extra", "lift", "0.1"], "--extra lift: must be one of temperature, drift, patience"),
        (["--human.extra", "ahead", "10"], "--human.extra.ahead 10.0: must be at least 0 and"),
        (["--observation-size", "4"], "--observation-size 4: must be 3, as the walkers have"),
        (["--action-size", "2"], "--action-size 2: must be 1, as the walkers have"),
    ],
)
def test_the_command_says_so(words, given, said, tmp_path, capsys):
    assert run_main("sweep", main, [*words, *given, "--out", str(tmp_path / "none")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {said}")
    assert error.count("\n") == 1
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"observation_size": 2}, "indicator hull_angle: is made for observations of 24 numbers"),
        (
            {"observation_size": 3, "indicator": "my_team:tilt"},
            "danger threshold: is made for observations of 24 numbers, and the walkers' have 3:",
        ),
        (
            {"observation_size": 3, "indicator": "my_team:tilt", "danger": "my_team:steep"},
            "human_actions scripted: is made for observations of 24 numbers",
        ),
        ({"action_size": 2}, "human_actions scripted: is made for actions of 4 numbers"),
    ],
)
def test_what_was_made_for_the_walker_refuses_another_environment(changes, said):
    with pytest.raises(InvalidValue, match=re.escape(said)):
        make_agent(paper_config(**changes))


def test_numbers_of_no_choice_are_refused():
    hyper = hyper_for(Method.SRL, paper_hyper(extra={"drift": 0.1}))
    with pytest.raises(InvalidValue, match=r"^extra drift: no choice has options"):
        agents.validate(make_agent(paper_config()), hyper)


def test_an_option_is_traced():
    """Another value compiles nothing anew, and moves the boundary otherwise."""
    agent = make_agent(_CONFIG)
    hypers = [
        agent.with_extra(hyper_for(Method.HITL_AC, paper_hyper(extra={"drift": drift})))
        for drift in (0.0, 0.1)
    ]
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *hypers)
    assert stacked.extra["drift"].tolist() == [0.0, 0.1]
    agents.validate(agent, hypers[0])


def test_all_fields_say_their_bounds():
    for instance in (paper_config(), paper_hyper(), RunHyper(), HumanParams(), LoopConfig()):
        require_fields(instance)

    @dataclasses.dataclass
    class Forgotten:
        known: int = whole(3)
        other: int = 4

    with pytest.raises(TypeError, match=r"Forgotten\.other: says no bounds"):
        require_fields(Forgotten())


def test_help_names_what_is_registered():
    for name in ("learner", "boundary_source", "intervention", "indicator", "danger"):
        assert f"\n    {name}: " in AgentConfig.__doc__
    assert "`td3` (two critics, smoothed target, delayed actor)" in AgentConfig.__doc__
    assert "initial_boundary: τ_0. This, Δ⁻, Δ⁺" in Hyper.__doc__


def test_a_name_is_registered_once():
    kinds = Registry("kind", "kind", callable)
    kinds.register("one", "the first")(print)
    with pytest.raises(ValueError, match="is registered already"):
        kinds.register("one", "again")
    for name in ("a:b", "", "a b", "-a", 3):
        with pytest.raises(ValueError, match="must be letters, digits"):
            kinds.register(name, "the second")
    assert kinds.make("one") is print and kinds.names == ("one",)


def test_a_module_of_the_current_folder_is_found(tmp_path, monkeypatch):
    """As the command `hitl-jax` starts: without the current folder in its path."""
    (tmp_path / "my_indicator.py").write_text("def lean(observation):\n    return observation[0]\n")
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", ".")])
    monkeypatch.chdir(tmp_path)
    config = paper_config(indicator="my_indicator:lean")
    assert float(make_agent(config).indicator(np.arange(24.0))) == 0.0
    with pytest.raises(InvalidValue, match="no_indicator cannot be imported"):
        make_agent(paper_config(indicator="no_indicator:lean"))
