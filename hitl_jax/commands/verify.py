"""Whether saved results can be had again: `hitl-jax verify RESULTS`.

Plays a sample of the runs: their recorded training episodes from the actions, their test episodes
from the parameters, each from its reset seed, and compares what the environment gives with what
the results say. Where they were made with other versions, or on another processor, it says so
first: rounding can differ then, and a walker's fate with it.
"""

import contextlib
import dataclasses
import pathlib
import random
from collections.abc import Sequence
from typing import get_args

import numpy as np
import tyro

from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input
from hitl_jax.envs import make_pool
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.evaluation.host import Evaluator
from hitl_jax.evaluation.trials import Mode
from hitl_jax.playback.episodes import (
    play_tests,
    playing_backend,
    require_repeatable,
    returns_of,
    tell_differences,
    training_seed,
)
from hitl_jax.playback.load_trained import agent_of, require_same_human
from hitl_jax.results.episode_tables import select
from hitl_jax.results.folder import ResultsFolder, Run
from hitl_jax.results.run_key import RunKey, sort_keys
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.team.agent import Agent

_SHOWN = 5


@dataclasses.dataclass(frozen=True)
class VerifyOptions:
    """Plays saved episodes again and compares their returns with the recorded ones.

    Attributes:
        results: a folder that a sweep has written.
        runs: number of runs to play, drawn at random; more than there are is all of them.
        sample: what the draw starts from.
        human_policy: the file given to the sweep under this name, if there was one.
    """

    results: tyro.conf.Positional[pathlib.Path]
    runs: int = 3
    sample: int = 0
    human_policy: str | None = None


def main(options: VerifyOptions) -> int:
    """Plays and compares.

    Args:
        options: what to play.

    Returns:
        The exit code: 0 if all agreed, else 1.

    Raises:
        BadInput: where there is nothing to play.
    """
    try:
        with checking_input():
            require("runs", options.runs, at_least=1)
            folder = ResultsFolder(options.results)
            require_repeatable(folder)
            require_same_human(folder, options.human_policy)
            agent = agent_of(folder, options.human_policy)
        keys = sort_keys(folder.finished())
        if not keys:
            raise BadInput(f"{options.results}: no run has finished yet")
        drawn = random.Random(options.sample).sample(keys, min(options.runs, len(keys)))
        chosen = sort_keys(set(drawn))
        tell_differences(folder, chosen)
        keep_programs()
        told = [_verify(agent, folder, key) for key in chosen]
    except ResultsError as error:
        raise BadInput(str(error)) from error
    agreed, played = (sum(column) for column in zip(*told, strict=True))
    print(f"{agreed} of {played} episodes of {len(told)} of {len(keys)} runs agree")
    return 0 if agreed == played else 1


def _verify(agent: Agent, folder: ResultsFolder, key: RunKey) -> tuple[int, int]:
    """Episodes of a run that agree, and that were played."""
    run = folder.load_run(key)
    results = {"training": _replay(folder, run)}
    autonomous = select(run.tests, "mode", "autonomous")["return"]
    if len(autonomous) and not run.diverged:
        with contextlib.closing(make_pool(playing_backend(folder), len(autonomous))) as pool:
            evaluator = Evaluator(agent, pool)
            for mode in get_args(Mode):
                recorded = select(run.tests, "mode", mode)["return"]
                if len(recorded):
                    tests = play_tests(agent, evaluator, folder, key, mode)
                    again = [test.row["return"] for test in tests]
                    results[mode] = list(zip(recorded.tolist(), again, strict=True))
    parts = [f"{mode} {_count(pairs)} of {len(pairs)}" for mode, pairs in results.items()]
    print(f"{key}: {', '.join(parts)}", flush=True)
    different = [pair for pairs in results.values() for pair in pairs if pair[0] != pair[1]]
    for recorded_return, now in different[:_SHOWN]:
        print(f"  recorded {recorded_return:.3f}, now {now:.3f}")
    every = [pair for pairs in results.values() for pair in pairs]
    return _count(every), len(every)


def _replay(folder: ResultsFolder, run: Run) -> list[tuple[float, float]]:
    """Returns of the recorded training episodes: in the table, and played again."""
    recordings = list(folder.load_recordings(run.key).values())
    if not recordings:
        return []
    with contextlib.closing(make_pool(playing_backend(folder), len(recordings))) as pool:
        seeds = [training_seed(run.key, recording.episode) for recording in recordings]
        actions = {place: recording.actions for place, recording in enumerate(recordings)}
        again = returns_of(pool, actions, np.array(seeds, np.uint32))
    table = run.episodes["return"].tolist()
    return [(table[one.episode - 1], now) for one, now in zip(recordings, again, strict=True)]


def _count(pairs: Sequence[tuple[float, float]]) -> int:
    return sum(recorded == again for recorded, again in pairs)
