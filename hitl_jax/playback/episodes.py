"""Episodes of a results folder, played again: recorded ones from their actions, tests anew."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from hitl_jax.choices.registry import require_trusted
from hitl_jax.envs import BACKENDS, OUR_WALKERS, WALKER, WalkerPool, make_pool, require_backend
from hitl_jax.envs.base import require_sizes
from hitl_jax.envs.episode_log import playback
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.evaluation.host import HostExaminer, play_trial
from hitl_jax.evaluation.trials import Mode, Trial
from hitl_jax.playback.load_trained import load_trained
from hitl_jax.results.config_diff import changes
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.folder import ResultsFolder, Run
from hitl_jax.results.provenance import origin
from hitl_jax.results.recorded_episodes import Recording
from hitl_jax.results.run_key import RunKey
from hitl_jax.tasks import task_of
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import episode_seed
from hitl_jax.training.step_booking import recorded_steps

_ON_LEAN = ("lean", "gymnasium", "envpool")
"""Played again on `lean`: it equals gymnasium's walker, and is quicker; EnvPool takes no seeds."""
_REPEATABLE = ("lean", "gymnasium", "jax")


class PlayedTest(NamedTuple):
    """A test episode, played again.

    Attributes:
        row: what it brought now.
        seed: its reset seed.
        episode: its steps.
    """

    row: Row
    seed: int
    episode: Recording


def training_seed(key: RunKey, episode: int) -> int:
    """Reset seed of a training episode, counted from 1."""
    return episode_seed(key.method, key.seed, episode - 1)


def returns_of(
    pool: WalkerPool, episodes: Mapping[int, np.ndarray], seeds: np.ndarray
) -> list[float]:
    """Plays episodes again, side by side; what the environment gave for each.

    Args:
        pool: of seedable walkers.
        episodes: actions by walker, [T, A] each.
        seeds: reset seed of each walker, uint32 [N].
    """
    totals = [0.0] * pool.num_walkers
    for command, action in playback(pool.num_walkers, episodes):
        reward = pool.step(command, action, seeds).reward
        totals = [total + float(more) for total, more in zip(totals, reward, strict=True)]
    return [totals[walker] for walker in episodes]


def play_tests(
    agent: Agent, examiner: HostExaminer, folder: ResultsFolder, key: RunKey, mode: Mode
) -> list[PlayedTest]:
    """Plays a run's tests once more, from its parameters.

    Args:
        agent: the team.
        examiner: with as many walkers as the tests had episodes.
        folder: the results.
        key: the run.
        mode: which tests.

    Raises:
        ResultsError: if the run is not there, or is not of this program.
    """
    spec, end = load_trained(agent, folder, key)
    seen: list[np.ndarray] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        del active  # the rows tell how long each episode was
        seen.append(recorded_steps(decided, agent.layout, spec.hyper))

    rows = play_trial(examiner, Trial(mode, spec, [end], examiner.num_episodes), watch)
    steps = np.stack(seen, axis=1)
    return [
        PlayedTest(
            row,
            episode_seed("test", key.seed, place),
            Recording(place + 1, steps[place, : row["length"]]),
        )
        for place, row in enumerate(rows)
    ]


def env_of(folder: ResultsFolder) -> str:
    """The task of a folder, see `task_of`."""
    env: str = folder.load_config().get("task", {}).get("env", WALKER)
    return env


def playing_backend(folder: ResultsFolder) -> str:
    """On which backend episodes of a folder are played again; a pool of one's own is its own.

    Raises:
        ResultsError: in one line, if that cannot be had here, or is code that is not trusted.
    """
    made, env = folder.load_config().get("backend", "lean"), env_of(folder)
    backend = made
    require_trusted(folder.path / "config.json", {"backend": backend, "env": env})
    try:
        BACKENDS.check(backend)
        played = task_of(env).env_id
        if made in _ON_LEAN and played in OUR_WALKERS:
            backend = "lean"
        require_backend(backend, played)
    except (InvalidValue, ImportError) as error:
        raise ResultsError(f"{folder.path}: made with --backend {made}: {error}") from error
    return backend


@contextlib.contextmanager
def playing_pool(folder: ResultsFolder, agent: Agent, num_walkers: int) -> Iterator[WalkerPool]:
    """The walkers on which episodes of a folder are played again.

    Args:
        folder: the results.
        agent: the team.
        num_walkers: how many.

    Raises:
        ResultsError: in one line, if they cannot be had here, or are not of the team's sizes.
    """
    backend, config = playing_backend(folder), agent.config
    with contextlib.ExitStack() as held:
        try:
            pool = make_pool(backend, num_walkers, env_id=env_of(folder))
            held.enter_context(contextlib.closing(pool))
            require_sizes(pool, config.observation_size, config.action_size)
        except InvalidValue as error:
            raise ResultsError(f"{folder.path}: made with --backend {backend}: {error}") from error
        yield pool


def differences(folder: ResultsFolder, keys: Iterable[RunKey]) -> str:
    """One line if runs were made with other versions, or on another processor; else empty.

    Raises:
        ResultsError: if a run is damaged.
    """
    now = origin()
    every = [line for key in keys for line in changes(_made(folder.load_run(key)), now)]
    if not every:
        return ""
    return (
        f"{folder.path} was made with {'; '.join(dict.fromkeys(every))}: "
        "numbers can differ by rounding, and a walker's fate with them"
    )


def _made(run: Run) -> dict[str, Any]:
    """What a run's numbers depended on, as `origin` has it."""
    made = {name: run.info[name] for name in ("versions", "commit")}
    if "machine" in run.info:  # The processor, and the number of its cores.
        made["processor"] = run.info["machine"].rpartition(", ")[0]
    return made


def require_repeatable(folder: ResultsFolder) -> None:
    """Refuses results whose episodes cannot be had again.

    Raises:
        ResultsError: in one line.
    """
    backend = folder.load_config().get("backend", "lean")
    if backend not in _REPEATABLE:
        raise ResultsError(
            f"{folder.path}: made with --backend {backend}, whose episodes cannot be played again"
        )
