"""docs/results-format.md names exactly what is written, and its programs mean what it says."""

import numpy as np
import pytest
from official import bipedal_walker, make
from pages import ROOT, first_column, python_in, run, section

from hitl_jax.analysis.summary import SUMMARY_COLUMNS
from hitl_jax.learner.networks import Actor
from hitl_jax.results import model_card
from hitl_jax.results.episode_tables import (
    ENDS,
    EPISODE_COLUMNS,
    MODES,
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
)
from hitl_jax.results.recorded_episodes import STEP_COLUMNS
from hitl_jax.results.run_files import RUN_FILES
from hitl_jax.team import checkpoint

PAGE = "docs/results-format.md"
RUN = ROOT / "results/ten_seeds/runs/hitl-ac/seed-0003"
EPISODES, PARAMS = "episodes.npz: episodes step by step", "params.npz: the final networks"
LAYOUT = "The observation and the action of BipedalWalker"


@pytest.mark.parametrize(
    ("heading", "columns"),
    [
        ("episodes.csv: training episodes", EPISODE_COLUMNS),
        ("test.csv: test episodes", TEST_COLUMNS),
        ("progress.csv: tests during training", PROGRESS_COLUMNS),
        ("summary.csv: a row for each run", SUMMARY_COLUMNS),
        ("The files of a run", ("run.json", *RUN_FILES, model_card.FILE)),
    ],
)
def test_tables_name_what_is_written_in_its_order(heading, columns):
    assert first_column(section(PAGE, heading)) == list(columns)


def test_words_in_tables():
    page = (ROOT / PAGE).read_text()
    for column, words in (("end", ENDS), ("mode", MODES)):
        [row] = [line for line in page.splitlines() if line.startswith(f"| `{column}` | word | `")]
        assert all(f"`{word}`" in row for word in words)


def test_arrays_of_recorded_episodes(tmp_path):
    with np.load(RUN / "episodes.npz") as file:
        arrays, columns = dict(file), list(STEP_COLUMNS)
    names = first_column(section(PAGE, EPISODES))
    assert sorted(names[:-5]) == sorted(arrays) and names[-5:] == columns
    made = run(python_in(section(PAGE, EPISODES))[0], tmp_path)
    steps = arrays["best/steps"]
    assert np.array_equal(made["action"], steps[:, :4])
    assert np.array_equal(made["boundary"], steps[:, 4 + columns.index("boundary")])
    assert np.array_equal(made["alarmed"], steps[:, 4 + columns.index("alarmed")] == 1)


def test_arrays_of_parameters():
    named = [name for name in first_column(section(PAGE, PARAMS)) if not name.startswith("risk/")]
    with np.load(RUN / "params.npz") as arrays:
        names = arrays.files
    assert set(named) <= set(names)
    assert {name.partition("/")[0] for name in named} == {name.partition("/")[0] for name in names}


def test_the_policy_in_numpy_is_the_actor(tmp_path):
    policy = run(python_in(section(PAGE, PARAMS))[0], tmp_path)["policy"]
    seen = np.random.default_rng(0).normal(size=(5, 24)).astype(np.float32)
    actor = checkpoint.load_actor(RUN / "params.npz", 24, 4)
    *hidden, size = checkpoint.hidden_sizes(actor)
    np.testing.assert_allclose(policy(seen), Actor(tuple(hidden), size).apply(actor, seen), 1e-4)


def test_all_runs_make_one_table(tmp_path):
    [code] = python_in((ROOT / PAGE).read_text().partition("## The files of a run")[0])
    alone = run(code, tmp_path)["alone"]
    assert alone.groupby(["method", "seed"]).size().eq(100).all() and len(alone) == 3000


def test_the_observation_in_physical_units(tmp_path):
    [code] = python_in(section(PAGE, LAYOUT))
    physical = run(code, tmp_path)["physical"]
    env = make()
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(40):
        observation, *_ = env.step(rng.uniform(-1, 1, 4).astype(np.float32))
    hips, knees = env.joints[0::2], env.joints[1::2]
    expected = {
        "hull_angle": env.hull.angle,
        "hull_angular_velocity": env.hull.angularVelocity,
        "forward_speed": env.hull.linearVelocity.x,
        "vertical_speed": env.hull.linearVelocity.y,
        "hip_angles": [joint.angle for joint in hips],
        "hip_speeds": [joint.speed for joint in hips],
        "knee_angles": [joint.angle for joint in knees],
        "knee_speeds": [joint.speed for joint in knees],
        "on_the_ground": [leg.ground_contact for leg in env.legs[1::2]],
        "lidar": [ray.fraction * bipedal_walker.LIDAR_RANGE for ray in env.lidar],
    }
    told = physical(observation)
    assert told.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(told[name], value, rtol=1e-4, atol=1e-5, err_msg=name)
    assert bipedal_walker.MOTORS_TORQUE == 80 and bipedal_walker.FPS == 50
