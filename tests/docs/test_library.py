"""The programs of docs/library.md run, and mean what the page says."""

import functools
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from official import needs_official
from pages import headings, python_in, run, section

from hitl_jax.human import HumanParams
from hitl_jax.human.indicator import hull_angle, hull_angular_velocity
from hitl_jax.results.episode_tables import EPISODE_COLUMNS
from hitl_jax.team import checkpoint

PAGE = "docs/library.md"


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """What the programs of sections define, each run once; sections in a row are one program."""
    folder = tmp_path_factory.mktemp("library")

    @functools.cache
    def of(*sections):
        code = [part for heading in sections for part in python_in(section(PAGE, heading))]
        return run("\n".join(code), folder) | {"folder": folder}

    return of


def observation(**numbers):
    """A walker's observation of zeros but for some numbers."""
    seen = np.zeros(24, np.float32)
    for place, value in numbers.items():
        seen[int(place[1:])] = value
    return jnp.asarray(seen)


def test_every_section_with_a_program_is_tried_here():
    source = pathlib.Path(__file__).read_text()
    with_program = [name for name in headings(PAGE)[1:] if python_in(section(PAGE, name))]
    assert len(with_program) == 6
    assert all(f'"{name}"' in source for name in with_program)


@pytest.mark.slow
def test_runs_are_trained_tested_and_saved(names):
    made = names("Train", "Test and save what was trained")
    assert len(made["finished"]) == 4
    assert sum(one.run.updates for one in made["finished"]) > 0
    for one, (tests, _) in zip(made["finished"], made["results"], strict=True):
        assert [row["episode"] for row in one.run.episodes] == [1, 2, 3]
        assert set(EPISODE_COLUMNS) <= set(one.run.episodes[0])
        assert [row["mode"] for row in tests] == ["autonomous"] * 4
        stem = made["folder"] / one.run.spec.key.file_name
        saved = checkpoint.load(stem.with_suffix(".npz"))
        assert checkpoint.networks_of(made["agent"], saved).keys() > {"actor", "boundary"}
        assert "mean_boundary" in stem.with_suffix(".csv").read_text()


@needs_official
def test_the_loaded_policy_walks_to_the_end(names):
    made = names("Load a trained policy and step it in gymnasium")
    assert made["total"] > 300 and made["terminated"]


def test_leaning_is_the_angle_plus_a_tenth_of_the_angular_velocity(names):
    made = names("A safety indicator of your own")
    seen = jnp.asarray(np.random.default_rng(0).normal(size=24), jnp.float32)
    expected = hull_angle(seen) + 0.1 * hull_angular_velocity(seen)
    np.testing.assert_allclose(made["leaning"](seen), expected, rtol=1e-6)
    assert made["agent"].indicator is made["leaning"]


def judged(part, observations, params, began=()):
    """What a human says of observations in a row, jitted."""
    judge, notify = jax.jit(part.judge), jax.jit(part.notify)
    state, said = part.begin_episode(part.init()), []
    for step, seen in enumerate(observations):
        state, dangerous = judge(state, params, seen, jnp.zeros((), bool), jax.random.key(step))
        said.append(bool(dangerous))
        state = notify(state, params, jnp.asarray(step in began), jnp.asarray(False))
    return said


def test_the_patient_human_waits_and_rests(names):
    made = names("A human of your own")
    tilted, level = observation(_0=-0.5), observation(_0=0.1)
    part, params = made["patient"](patience=3, rest=2), HumanParams(tolerance=0.4)
    seen = [tilted, tilted, level, tilted, tilted, tilted, tilted, tilted, tilted]
    # Three in a row are complete at step 5; the rest after it covers steps 6 and 7.
    assert judged(part, seen, params) == [False] * 5 + [True] * 4
    assert judged(part, seen, params, began={5}) == [False] * 5 + [True, False, False, True]
    # The chain delays that by ten steps.
    slow = HumanParams(tolerance=0.4, delay=10)
    assert judged(made["mine"], [tilted] * 20, slow) == [False] * 14 + [True] * 6


@pytest.mark.slow
def test_eight_runs_are_updated_at_once(names):
    made = names("The update functions alone")
    assert made["metrics"]["q"].shape == (8,) and jnp.isfinite(made["metrics"]["q"]).all()
    kernels = made["states"].learner.actor["params"]["Dense_0"]["kernel"]
    assert kernels.shape == (8, 24, 64) and not np.array_equal(kernels[0], kernels[1])
