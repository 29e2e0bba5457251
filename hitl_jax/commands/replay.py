"""An episode looked at afterwards: `hitl-jax replay RESULTS --seed 3`.

Plays a recorded training episode again from its seed and actions, or a test episode from the saved
parameters, checks that its return is the recorded one, and makes a film of it.
"""

import contextlib
import dataclasses
import itertools
import pathlib
from typing import Literal, NamedTuple

import jax
import numpy as np
import tyro

from hitl_jax.choices.checks import require
from hitl_jax.config import Method
from hitl_jax.console.cli import checking_input
from hitl_jax.envs import make_pool
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.evaluation.host import Evaluator
from hitl_jax.playback import film
from hitl_jax.playback.episodes import (
    play_tests,
    playing_backend,
    require_repeatable,
    tell_differences,
    training_seed,
)
from hitl_jax.playback.load_trained import agent_of, require_same_human
from hitl_jax.results.episode_tables import select
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import BEST, Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.team.agent import Agent

_SPAN = 1.5


@dataclasses.dataclass(frozen=True)
class ReplayOptions:
    """Makes a film of an episode, and checks its return.

    Attributes:
        results: a folder that a sweep has written.
        method: srl, hitl-fix or hitl-ac.
        seed: the run's.
        phase: a `training` episode, or one of the `autonomous` or `assisted` test.
        episode: its number, from 1. By default of training the best one, of a test the first. Of
            training, a run's best episode and that of its first intervention are recorded.
        out: the film, .gif, or .mp4 (which needs the extra `video`). By default a .gif in
            RESULTS/replays.
        width: of the film, in pixels.
        human_policy: the file given to the sweep under this name, if there was one.
    """

    results: tyro.conf.Positional[pathlib.Path]
    method: str = "hitl-ac"
    seed: int = 0
    phase: Literal["training", "autonomous", "assisted"] = "training"
    episode: int | None = None
    out: pathlib.Path | None = None
    width: int = 600
    human_policy: str | None = None


def main(options: ReplayOptions) -> int:
    """Plays, compares and draws.

    Args:
        options: which episode.

    Returns:
        The exit code: 0, or 1 if the return is another than the recorded one.

    Raises:
        BadInput: where there is no such episode.
    """
    try:
        with checking_input():
            require("width", options.width, at_least=100, at_most=2000)
            if options.out:
                film.require_format(options.out)
            folder = ResultsFolder(options.results)
            require_repeatable(folder)
            require_same_human(folder, options.human_policy)
            agent = agent_of(folder, options.human_policy)
        key = _key(options, folder)
        keep_programs()
        if options.phase == "training":
            seed, episode, recorded = _find_recorded(folder, key, options)
        else:
            seed, episode, recorded = _find_test(agent, folder, key, options)
        name = f"{key.method}-seed-{key.seed}-{options.phase}-{episode.episode}"
        out = options.out or options.results / "replays" / f"{name}.gif"
        phase = "training" if options.phase == "training" else f"{options.phase} test"
        title = f"{key.method.upper()}, seed {key.seed}, {phase}, episode {episode.episode}"
        shown = _Shown(playing_backend(folder), seed, episode)
        again = _film(agent, shown, out, title, options.width)
    except ResultsError as error:
        raise BadInput(str(error)) from error
    print(out)
    if again != recorded:
        tell_differences(folder, [key])
        print(f"its return is {again:.3f}, the recorded one {recorded:.3f}: not the same episode")
        return 1
    print(f"its return is the recorded one, {recorded:.3f}, after {len(episode.steps)} steps")
    return 0


def _key(options: ReplayOptions, folder: ResultsFolder) -> RunKey:
    methods = [str(method) for method in Method]
    if options.method not in methods:
        raise BadInput(f"--method {options.method}: must be one of {', '.join(methods)}")
    seeds = sorted(key.seed for key in folder.finished() if key.method == options.method)
    if options.seed not in seeds:
        there = ", ".join(map(str, seeds)) or "(none)"
        raise BadInput(f"--seed {options.seed}: finished seeds of {options.method} are {there}")
    return RunKey(options.method, options.seed)


def _find_recorded(
    folder: ResultsFolder, key: RunKey, options: ReplayOptions
) -> tuple[int, Recording, float]:
    """Reset seed, steps and recorded return of a training episode."""
    recordings = folder.load_recordings(key)
    if not recordings:
        raise BadInput(f"{options.results}: no training episode of {key} is recorded")
    number = recordings[BEST].episode if options.episode is None else options.episode
    for episode in recordings.values():
        if episode.episode == number:
            recorded = folder.load_run(key).episodes["return"][number - 1]
            return training_seed(key, number), episode, float(recorded)
    there = ", ".join(f"{kept.episode} ({name})" for name, kept in recordings.items())
    raise BadInput(f"--episode {number}: recorded training episodes of {key} are {there}")


def _find_test(
    agent: Agent, folder: ResultsFolder, key: RunKey, options: ReplayOptions
) -> tuple[int, Recording, float]:
    """Reset seed, steps and recorded return of a test episode; all are played for it."""
    assert options.phase != "training"
    run = folder.load_run(key)
    if run.diverged:
        raise BadInput(f"{options.results}: {key} diverged; its tests count as falls, unplayed")
    recorded = select(run.tests, "mode", options.phase)["return"]
    number = 1 if options.episode is None else options.episode
    if not 1 <= number <= len(recorded):
        raise BadInput(
            f"--episode {number}: {key} has {len(recorded)} episodes of the {options.phase} test"
        )
    with contextlib.closing(make_pool(playing_backend(folder), len(recorded))) as pool:
        tests = play_tests(agent, Evaluator(agent, pool), folder, key, options.phase)
    test = tests[number - 1]
    return test.seed, test.episode, float(recorded[number - 1])


class _Shown(NamedTuple):
    """What a film shows: an episode, played on a backend from a reset seed."""

    backend: str
    seed: int
    episode: Recording


def _film(agent: Agent, shown: _Shown, out: pathlib.Path, title: str, width: int) -> float:
    """Makes the film; the return of what it shows."""
    backend, seed, episode = shown
    steps = list(film.play(backend, seed, episode.actions, pictures=False))
    observations = np.array([observation for observation, _, _ in steps])
    returns = list(itertools.accumulate(reward for _, _, reward in steps))
    indicators = np.asarray(jax.vmap(agent.indicator)(observations))
    name = agent.config.indicator.replace("_", " ")
    unit = "rad" if agent.config.indicator == "hull_angle" else ""
    drawn = film.play(backend, seed, episode.actions)
    pictures = ((picture, total) for (_, picture, _), total in zip(drawn, returns, strict=True))
    caption = film.Caption(title, name, unit, indicators, _SPAN)
    film.write(out, film.annotate(pictures, episode, caption), width)
    return returns[-1]
