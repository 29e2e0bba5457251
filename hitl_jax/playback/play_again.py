"""Episodes of a run, played again: recorded training episodes from their actions, tests anew."""

from typing import get_args

import numpy as np

from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.evaluation.trials import Mode
from hitl_jax.playback.episodes import play_tests, playing_pool, returns_of, training_seed
from hitl_jax.results.episode_tables import select
from hitl_jax.results.folder import ResultsFolder, Run
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.agent import Agent

Pairs = list[tuple[float, float]]
"""Returns of episodes: the recorded one, and that of now."""


def play_again(agent: Agent, folder: ResultsFolder, key: RunKey) -> dict[str, Pairs]:
    """Returns of a run's episodes, recorded and now, by phase: `training` and the tests.

    Args:
        agent: the team.
        folder: the results.
        key: the run.

    Raises:
        ResultsError: if the run is not there, or damaged.
    """
    run = folder.load_run(key)
    results = {"training": _replay(agent, folder, run)}
    autonomous = select(run.tests, "mode", "autonomous")["return"]
    if len(autonomous) and not run.diverged:
        with playing_pool(folder, agent, len(autonomous)) as pool:
            examiner = HostExaminer(agent, pool)
            for mode in get_args(Mode):
                recorded = select(run.tests, "mode", mode)["return"]
                if len(recorded):
                    tests = play_tests(agent, examiner, folder, key, mode)
                    again = [test.row["return"] for test in tests]
                    results[mode] = list(zip(recorded.tolist(), again, strict=True))
    return results


def _replay(agent: Agent, folder: ResultsFolder, run: Run) -> Pairs:
    """Returns of the recorded training episodes: in the table, and played again."""
    recordings = list(folder.load_recordings(run.key).values())
    if not recordings:
        return []
    with playing_pool(folder, agent, len(recordings)) as pool:
        seeds = [training_seed(run.key, recording.episode) for recording in recordings]
        actions = {place: recording.actions for place, recording in enumerate(recordings)}
        again = returns_of(pool, actions, np.array(seeds, np.uint32))
    table = run.episodes["return"].tolist()
    return [(table[one.episode - 1], now) for one, now in zip(recordings, again, strict=True)]
