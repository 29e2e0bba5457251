"""Tasks: those that come with the package, one of a user's own, and what is said of bad ones."""

import json

import numpy as np
import pytest
import small

from hitl_jax.choices.registry import require_trusted
from hitl_jax.commands import human, replay, verify
from hitl_jax.commands.seed_sweep import main
from hitl_jax.console.cli import run_main
from hitl_jax.envs import Command, default_backend, make_pool
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.results.episode_measures import how_it_ended
from hitl_jax.sweep import run_sweep
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.sweep.presets import FULL, PRESETS
from hitl_jax.sweep.train_and_test import make_team
from hitl_jax.tasks import TASKS, Task, task_of
from hitl_jax.team.agent import validate

_SMALL = [
    *("--seeds", "1", "--episodes", "2", "--test-episodes", "2", "--warmup-steps", "100"),
    *small.OPTIONS,
]


@pytest.mark.parametrize("env", TASKS)
def test_what_a_task_says_holds_with_every_preset_and_makes_a_team(env):
    for preset in PRESETS:
        options = SweepOptions.of_preset(preset, env=env)
        held = vars(options.agent) | vars(options.hyper) | vars(options.hyper.human)
        assert task_of(env).changes.items() <= held.items()
        assert options.env == env
        validate(make_team(options.agent, None), options.hyper)


@pytest.mark.parametrize("env", TASKS)
def test_the_environment_is_as_its_task_says(env):
    """Its sizes, and that who acts at random falls."""
    rng, agent = np.random.default_rng(0), SweepOptions.of_preset(FULL, env=env).agent
    with make_pool(default_backend(task_of(env).env_id), 1, env_id=env) as pool:
        sizes = pool.observation_size, pool.action_size
        assert sizes == (agent.observation_size, agent.action_size)
        zero, seed = np.zeros((1, sizes[1]), np.float32), np.zeros(1, np.uint32)
        pool.step(np.array([Command.RESET]), zero, seed)
        ended, steps = False, 0
        while not ended and steps < 1000:
            action = rng.uniform(-1, 1, zero.shape).astype(np.float32)
            after = pool.step(np.array([Command.STEP]), action, seed)
            ended, steps = bool(after.terminated[0]), steps + 1
        assert how_it_ended(float(after.reward[0]), ended, False, pool.ends) == "fall"


@pytest.fixture(scope="module")
def swung(tmp_path_factory):
    """A sweep of `pendulum_task`."""
    out = tmp_path_factory.mktemp("pendulum") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_sweep, "draw", lambda _: [])
        assert run_main("sweep", main, [*_SMALL, *_OWN, "--out", str(out)]) == 0
    return out


_OWN = ("--env", "pendulum_task:pendulum", "--methods", "hitl-ac")


@pytest.mark.slow
def test_a_task_of_ones_own_is_swept_and_its_episodes_come_again(swung, capsys, monkeypatch):
    config = json.loads((swung / "config.json").read_text())["config"]
    assert config["task"]["env"] == "pendulum_task:pendulum"
    assert config["agent"]["observation_size"] == 3
    assert run_main("verify", verify.main, [str(swung)]) == 2
    assert "env pendulum_task:pendulum" in capsys.readouterr().err
    monkeypatch.setenv("HITL_JAX_MODULES", "pendulum_task")
    assert run_main("verify", verify.main, [str(swung), "--runs", "1"]) == 0
    film = swung / "film.gif"
    words = ["--phase", "autonomous", "--out", str(film), "--width", "100"]
    assert run_main("replay", replay.main, [str(swung), *words]) == 0
    assert film.stat().st_size > 0
    assert run_main("sweep", main, [*_SMALL, *_OWN, "--out", str(swung)]) == 0


@pytest.mark.slow
def test_another_task_is_refused_in_its_folder(swung, capsys):
    words = [*_SMALL, "--env", "LunarLanderContinuous-v3", "--out", str(swung)]
    assert run_main("sweep", main, words) == 2
    assert "made with another config" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--env", ""], "--env '': must name an environment"),
        (["--env", "Hoper-v5"], "--env Hoper-v5: "),
        (["--env", "no_module:task"], "--env no_module:task: no_module cannot be imported"),
        (["--env", "small:TEAM"], "--env small:TEAM: must be one of BipedalWalker-v3"),
        (["--env", "pendulum_task:none"], "--env pendulum_task:none: pendulum_task has no none"),
        (["--env", "CartPole-v1"], "--env CartPole-v1: actions must be flat vectors"),
        (["--env", "Pendulum-v1"], "--indicator hull_angle: is made for observations of 24"),
        (
            ["--env", "LunarLanderContinuous-v3", "--backend", "lean"],
            "--backend lean: plays BipedalWalker-v3 and BipedalWalkerHardcore-v3 alone: must be ",
        ),
        ([*_OWN, "--observation-size", "5"], "--observation-size 5: must be 3"),
    ],
)
def test_a_bad_task_is_one_line(words, said, tmp_path, capsys):
    assert run_main("sweep", main, [*_SMALL, *words, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {said}")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_task_that_changes_no_option_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("pendulum_task.pendulum", Task("Pendulum-v1", changes={"angle": 1}))
    assert run_main("sweep", main, [*_OWN]) == 2
    said = "--env pendulum_task:pendulum: its task changes options: angle: no such option"
    assert f"error: {said}" in capsys.readouterr().err


def test_a_human_is_made_of_tasks_alone(capsys):
    assert run_main("human", human.main, ["--env", "Pendulum-v1"]) == 2
    assert "error: --env Pendulum-v1: must be one of BipedalWalker-v3" in capsys.readouterr().err


@pytest.mark.parametrize("env", ["a-b:Foo-v0", "é:Foo-v0", "1x:Foo-v0", "os:path", "a.b-c:Foo-v0"])
def test_an_environment_that_a_folder_names_with_a_module_is_code(env):
    with pytest.raises(ResultsError, match="names code that would be run: env"):
        require_trusted("config.json", {"env": env})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"env_id": 3}, "env_id 3: must name an environment"),
        ({"ends": None}, "ends NoneType: must be an EndRule"),
        ({"changes": None}, "changes NoneType: must be a mapping"),
        ({"episodes": 0}, "episodes 0: must be at least 1"),
        ({"solved": "x"}, "solved x: must be"),
        ({"steps_per_second": 0}, "steps_per_second 0: must be a finite number above 0"),
    ],
)
def test_a_task_says_what_is_wrong_with_it(changes, said):
    with pytest.raises(InvalidValue, match=f"^{said}"):
        Task(**{"env_id": "Pendulum-v1"} | changes)
