"""A run that is loaded acts as its tests did, whole tables are read, cards are written."""

import json

import gymnasium
import numpy as np
import pandas
import pytest
from official import needs_official
from pages import ROOT

from hitl_jax import load_run, load_table
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.model_card import model_card
from hitl_jax.results.run_key import RunKey
from hitl_jax.training.run_spec import episode_seed

_FULL = ROOT / "results" / "full"
_RUN = _FULL / "runs" / "hitl-ac" / "seed-0003"


@pytest.fixture(scope="module")
def policy():
    return load_run(_RUN)


@needs_official
def test_it_walks_as_its_first_test_did(policy):
    tests = pandas.read_csv(_RUN / "test.csv")
    env = gymnasium.make("BipedalWalker-v3")
    observation, _ = env.reset(seed=episode_seed("test", 3, 0))
    total, steps, ended = 0.0, 0, False
    while not ended:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        total, steps, ended = total + reward, steps + 1, terminated or truncated
    first = tests[tests["mode"] == "autonomous"].iloc[0]
    assert abs(total - first["return"]) < 3 and abs(steps - first["length"]) < 20


def test_one_observation_or_many(policy):
    seen = np.random.default_rng(0).normal(size=(5, 24)).astype(np.float32)
    actions = policy(seen)
    assert actions.shape == (5, 4) and actions.dtype == np.float32
    np.testing.assert_allclose(policy(seen[2]), actions[2], rtol=1e-5, atol=1e-6)
    decided = policy.decide(seen)
    assert decided.boundary.shape == (5,)
    assert ((decided.boundary >= 0) & (decided.boundary <= 1.5)).all()
    with pytest.raises(ValueError, match=r"observation \(3,\): must be \[24\] or \[N, 24\]"):
        policy(np.zeros(3))


@pytest.mark.parametrize("path", [_FULL, _FULL / "runs", _RUN.parent, "nowhere"])
def test_what_is_no_run_is_refused(path):
    with pytest.raises(ResultsError, match="must be a run's folder"):
        load_run(path)


def test_a_run_that_is_not_there_is_refused():
    with pytest.raises(ResultsError, match="seed-0999"):
        load_run(_RUN.with_name("seed-0999"))


def test_all_runs_are_one_table():
    tests = pandas.DataFrame(load_table(_FULL, "test"))
    assert len(tests) == 30 * (100 + 200 + 200)
    alone = tests[tests["mode"] == "autonomous"].groupby(["method", "seed"])["return"].mean()
    summary = pandas.read_csv(_FULL / "summary.csv").set_index(["method", "seed"])
    np.testing.assert_allclose(alone, summary["test_return_mean"].sort_index(), rtol=1e-6)
    with pytest.raises(InvalidValue, match="table tests: must be one of episodes, test, progress"):
        load_table(_FULL, "tests")


def test_a_card_says_what_was_tested():
    run = ResultsFolder(_FULL).load_run(RunKey("hitl-ac", 3))
    card = model_card(run.key, run.info, run.episodes, run.tests)
    _, head, text = card.split("---\n", 2)
    alone = run.tests["return"][run.tests["mode"] == "autonomous"].mean()
    (index,) = [line for line in head.splitlines() if line.startswith("model-index: ")]
    [result] = json.loads(index.partition(": ")[2])[0]["results"]
    assert result["metrics"][0]["value"] == pytest.approx(alone, abs=0.01)
    assert result["dataset"]["name"] == "BipedalWalker-v3"
    assert f"| tested alone | return {alone:.1f} ± " in text
    assert "| in human hands | " in text and "HITL-AC, seed 3" in text
