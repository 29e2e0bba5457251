"""Episodes with all that was seen and decided in them, whoever played: the common form."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hitl_jax.envs import WalkerPool
from hitl_jax.envs.episode_log import playback
from hitl_jax.evaluation.host import HostExaminer
from hitl_jax.playback.episodes import (
    env_of,
    play_tests,
    playing_pool,
    require_repeatable,
    training_seed,
)
from hitl_jax.playback.load_trained import able_to_play, agent_of, require_same_human
from hitl_jax.playback.replay import Phase
from hitl_jax.results.episode_tables import select
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.recorded_episodes import STEP_COLUMNS, Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.agent import Agent


class Played(NamedTuple):
    """An episode.

    Attributes:
        name: who played it, a few words.
        seed: its reset seed.
        observations: the first, and that after each step, float32 [T + 1, O].
        actions: executed, in [-1, 1], float32 [T, A].
        rewards: of the environment, float32 [T].
        terminated: whether the environment ended the task, bool [T].
        truncated: whether the episode ended otherwise: by time, or by the human, bool [T].
        boundary: τ_t at each step; NaN without an arbiter, float32 [T].
        alarmed: C, bool [T].
        dangerous: the human's h_t = 0, bool [T].
        human_action: whether the human's action was executed, bool [T].
        judged: whether a human was there to judge the step, bool [T].
    """

    name: str
    seed: int
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    boundary: np.ndarray
    alarmed: np.ndarray
    dangerous: np.ndarray
    human_action: np.ndarray
    judged: np.ndarray


class Source(NamedTuple):
    """Where episodes come from.

    Attributes:
        env: the task, see `hitl_jax.tasks.task_of`.
        told: what they are, a few words.
        episodes: one after the other.
    """

    env: str
    told: str
    episodes: Iterator[Played]


def of_results(
    folder: ResultsFolder, phase: Phase, methods: Sequence[str], human_policy: str | None = None
) -> Source:
    """Episodes of all runs of a results folder, played again.

    Args:
        folder: the results.
        phase: `training` (the recorded episodes), or a test.
        methods: whose runs.
        human_policy: the file given to the sweep under this name, if there was one.

    Raises:
        ValueError: one line, if they cannot be played again.
    """
    require_repeatable(folder)
    require_same_human(folder, human_policy)
    agent = agent_of(folder, human_policy)
    told = "recorded training episodes" if phase == "training" else f"{phase} tests"
    return Source(env_of(folder), told, _played(folder, agent, phase, methods))


def _played(
    folder: ResultsFolder, agent: Agent, phase: Phase, methods: Sequence[str]
) -> Iterator[Played]:
    keys = [key for key in able_to_play(folder, lambda line: None) if key.method in methods]
    for key in keys:
        episodes = _recorded(folder, key) if phase == "training" else None
        if episodes is None:
            episodes = _tested(folder, agent, key, phase)
        if not episodes:
            continue
        with playing_pool(folder, agent, len(episodes)) as pool:
            name = f"{key}, {phase}"
            yield from _again(pool, name, episodes, key.method != "srl")


def _recorded(folder: ResultsFolder, key: RunKey) -> list[tuple[int, Recording]]:
    kept = {one.episode: one for one in folder.load_recordings(key).values()}
    return [(training_seed(key, number), one) for number, one in sorted(kept.items())]


def _tested(
    folder: ResultsFolder, agent: Agent, key: RunKey, mode: Phase
) -> list[tuple[int, Recording]]:
    count = len(select(folder.load_run(key).tests, "mode", mode)["return"])
    if mode == "training" or not count:
        return []
    with playing_pool(folder, agent, count) as pool:
        tests = play_tests(agent, HostExaminer(agent, pool), folder, key, mode)
    return [(test.seed, test.episode) for test in tests]


def _again(
    pool: WalkerPool, name: str, episodes: Sequence[tuple[int, Recording]], judged: bool
) -> list[Played]:
    """Plays episodes side by side, from their actions."""
    seeds = np.array([seed for seed, _ in episodes], np.uint32)
    actions = {place: one.actions for place, (_, one) in enumerate(episodes)}
    ticks = [pool.step(*tick, seeds) for tick in playback(pool.num_walkers, actions)]
    played = []
    for place, (seed, one) in enumerate(episodes):
        steps = len(one.steps)
        after = [[getattr(tick, field)[place] for tick in ticks] for field in ticks[0]._fields]
        seen, reward, terminated, truncated = (np.array(values) for values in after)
        cut = truncated[1 : steps + 1].copy()
        cut[-1] |= not terminated[steps]  # Time, or the human, ended it.
        columns = {column: one.column(column) for column in STEP_COLUMNS}
        played.append(
            Played(
                name=f"{name} episode {one.episode}",
                seed=seed,
                observations=seen[: steps + 1],
                actions=one.actions,
                rewards=reward[1 : steps + 1],
                terminated=terminated[1 : steps + 1],
                truncated=cut,
                boundary=columns["boundary"],
                alarmed=columns["alarmed"] > 0,
                dangerous=columns["dangerous"] > 0,
                human_action=columns["human_action"] > 0,
                judged=np.full(steps, judged),
            )
        )
    return played
