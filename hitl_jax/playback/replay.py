"""An episode of a results folder, found, played again and filmed."""

import itertools
import pathlib
from typing import Literal, NamedTuple

import jax
import numpy as np

from hitl_jax.choices.checks import one_of
from hitl_jax.config import Method
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import Mode
from hitl_jax.human.indicator import unit_of
from hitl_jax.playback import film
from hitl_jax.playback.episodes import play_tests, playing_pool, training_seed
from hitl_jax.results.episode_tables import select
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import BEST, Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.agent import Agent
from hitl_jax.types import Behavior

_SPAN = 1.5

Phase = Literal["training", "autonomous", "assisted"]


class Found(NamedTuple):
    """An episode that can be played again.

    Attributes:
        seed: its reset seed.
        episode: its steps.
        recorded: its return in the results.
    """

    seed: int
    episode: Recording
    recorded: float


def find_run(folder: ResultsFolder, method: str, seed: int) -> RunKey:
    """A finished run.

    Raises:
        InvalidValue: one line, if there is none.
    """
    one_of("method", method, tuple(Method))
    seeds = sorted(key.seed for key in folder.finished() if key.method == method)
    if seed not in seeds:
        there = ", ".join(map(str, seeds)) or "(none)"
        raise InvalidValue("seed", seed, f"finished seeds of {method} are {there}")
    return RunKey(method, seed)


def find_episode(
    agent: Agent, folder: ResultsFolder, key: RunKey, phase: Phase, number: int | None
) -> Found:
    """An episode of a run.

    Args:
        agent: the team.
        folder: the results.
        key: the run.
        phase: of its training, or of a test; all episodes of the test are played for it.
        number: counted from 1; None is the best of training, the first of a test.

    Raises:
        InvalidValue: one line, if there is no such episode.
        ResultsError: one line, if the run has none of this phase.
    """
    if phase == "training":
        return _find_recorded(folder, key, number)
    return _find_test(agent, folder, key, phase, 1 if number is None else number)


def _find_recorded(folder: ResultsFolder, key: RunKey, number: int | None) -> Found:
    recordings = folder.load_recordings(key)
    if not recordings:
        raise ResultsError(f"{folder.path}: no training episode of {key} is recorded")
    if number is None:
        number = recordings[BEST].episode
    for episode in recordings.values():
        if episode.episode == number:
            recorded = folder.load_run(key).episodes["return"][number - 1]
            return Found(training_seed(key, number), episode, float(recorded))
    there = ", ".join(f"{kept.episode} ({name})" for name, kept in recordings.items())
    raise InvalidValue("episode", number, f"recorded training episodes of {key} are {there}")


def _find_test(agent: Agent, folder: ResultsFolder, key: RunKey, mode: Mode, number: int) -> Found:
    run = folder.load_run(key)
    if run.diverged:
        raise ResultsError(f"{folder.path}: {key} diverged; its tests count as falls, unplayed")
    recorded = select(run.tests, "mode", mode)["return"]
    if not 1 <= number <= len(recorded):
        raise InvalidValue(
            "episode", number, f"{key} has {len(recorded)} episodes of the {mode} test"
        )
    with playing_pool(folder, agent, len(recorded)) as pool:
        tests = play_tests(agent, HostExaminer(agent, pool), folder, key, mode)
    test = tests[number - 1]
    return Found(test.seed, test.episode, float(recorded[number - 1]))


def make_film(
    agent: Agent,
    params: Behavior | None,
    backend: str,
    env_id: str,
    found: Found,
    out: pathlib.Path,
    title: str,
    width: int,
) -> float:
    """Plays an episode again, and makes a film of it.

    Args:
        agent: whose indicator is shown.
        params: of the trained run, by which a learned indicator tells the risk; else None.
        backend: that plays.
        env_id: gymnasium's name of the environment.
        found: the episode.
        out: the film.
        title: over it.
        width: in pixels.

    Returns:
        The return of what it shows.

    Raises:
        ResultsError: if it cannot be written.
    """
    seed, episode, _ = found
    steps = list(film.play(backend, env_id, seed, episode.actions, pictures=False))
    observations = np.array([observation for observation, _, _ in steps])
    returns = list(itertools.accumulate(reward for _, _, reward in steps))
    indicate = jax.vmap(agent.safety_indicator, in_axes=(None, 0))
    indicators = np.asarray(indicate(params, observations))
    name = agent.config.indicator.replace("_", " ")
    unit = unit_of(agent.config.indicator).removesuffix("1")
    drawn = film.play(backend, env_id, seed, episode.actions)
    pictures = ((picture, total) for (_, picture, _), total in zip(drawn, returns, strict=True))
    caption = film.Caption(title, name, unit, indicators, _SPAN)
    film.write(out, film.annotate(pictures, episode, caption), width)
    return returns[-1]
