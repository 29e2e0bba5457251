"""The map of a boundary that an actor gives, from a folder with an untrained walker."""

import csv
import dataclasses

import compiled
import jax
import numpy as np
import pytest
from paper_team import paper_config, paper_hyper

from hitl_jax.analysis.boundary_map import DATA
from hitl_jax.commands import boundary_map
from hitl_jax.console.cli import run_main
from hitl_jax.playback.load_trained import agent_of, load_trained
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, TEST_COLUMNS
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.team import agent as agents
from hitl_jax.team import checkpoint

_KEY = RunKey("hitl-ac", 0)


def _folder(path, source, carry=0.25):
    config = paper_config(hidden_sizes=(16,), boundary_source=source)
    folder = ResultsFolder(path)
    hyper = dataclasses.asdict(paper_hyper(initial_boundary=0.6))
    document = {"agent": dataclasses.asdict(config), "hyper": hyper, "episodes": 1}
    folder.create_or_resume(document, "command")
    state = compiled.init(agents.make_agent(config), jax.random.key(0))
    info = {"config": document, "versions": {}, "commit": None}
    info |= {"wall_seconds": 1.0, "env_steps": 0, "updates": 0}
    episodes = {name: [0] for name in EPISODE_COLUMNS} | {"end": ["fall"]}
    tests = {name: [] for name in TEST_COLUMNS}
    folder.save_run(_KEY, episodes, tests, checkpoint.flatten(state, np.float32(carry)), info)
    return folder


def _run(folder, *options):
    return run_main("boundary-map", boundary_map.main, [str(folder.path), *options])


@pytest.mark.parametrize(
    ("source", "carry", "expected"),
    [("network", 0.25, 0.6), ("residual", 0.25, 0.85), ("residual", -0.9, 0.05)],
)
def test_the_map_shows_what_is_executed(tmp_path, source, carry, expected):
    folder = _folder(tmp_path / "out", source, carry)
    assert _run(folder, "--episodes", "2") == 0
    rows = list(csv.DictReader((folder.path / DATA).read_text().splitlines()))
    assert rows
    # An untrained actor gives τ_0 everywhere; `residual` adds what line 8 has gathered, but 0.05
    # is the least boundary.
    assert [float(row["boundary"]) for row in rows] == pytest.approx([expected] * len(rows))
    assert (folder.path / "figures" / "figure9_map.png").exists()


def test_the_rule_has_no_map(tmp_path, capsys):
    assert _run(_folder(tmp_path / "out", "rule")) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert "its boundary source is rule: must be one of network, residual" in said


def test_a_run_comes_back_as_it_trained(tmp_path):
    folder = _folder(tmp_path / "out", "network")
    assert agent_of(folder).config.hidden_sizes == (16,)
    spec, end = load_trained(agent_of(folder), folder, _KEY)
    assert (spec.method, spec.seed, spec.episodes) == ("hitl-ac", 0, 1)
    assert spec.hyper.initial_boundary == 0.6
    assert end.boundary == np.float32(0.25)
