"""Whole episodes: the returns of one walker's policy in gymnasium's environment and in ours."""

import pathlib
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.envs import Command, WalkerPool, make_pool
from hitl_jax.evaluation.host import HostExaminer, play_trial
from hitl_jax.evaluation.trials import Trial
from hitl_jax.human import actions
from hitl_jax.playback.load_trained import able_to_play, agent_of, load_trained
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.xla.threefry import make_key

THERE, HERE = "lean", "jax"
"""The official walker, bit for bit, and ours."""

_WALKERS = 128
_FIRST_SEED = 1_000_000
"""Of reset seeds, apart from those of tests and training."""


def measure_scripted(episodes: int, env_id: str) -> list[Row]:
    """The distributions of the scripted walker's return over episodes of their own."""
    returns = []
    for backend in (THERE, HERE):
        with make_pool(backend, min(_WALKERS, episodes), env_id=env_id) as pool:
            returns.append(_scripted_returns(pool, episodes))
    there, here = returns
    rows: list[Row] = []
    for name, values in (("Box2D", there), ("hitl_jax.walker", here)):
        low, high = stats.bootstrap_interval(values, stats.mean)
        rows.append(
            {
                "scripted walker": name,
                "episodes": len(values),
                "mean return": round(float(values.mean()), 1),
                "95 %": f"{low:.1f} to {high:.1f}",
                "median": round(float(np.median(values)), 1),
            }
        )
    rows[1] |= {
        "means apart": round(abs(float(there.mean() - here.mean())), 1),
        "bar": 10,
        "Kolmogorov-Smirnov": round(distance(there, here), 3),
        "its bar": 0.08,
    }
    return rows


def measure_trained(
    folders: tuple[str, ...], runs: int, episodes: int, say: Callable[[str], None]
) -> list[Row]:
    """What trained walkers keep of their mean return in the environment that they do not know.

    Args:
        folders: of sweeps.
        runs: of each folder, spread over its methods.
        episodes: of a run in each environment.
        say: is told which runs are left out.
    """
    rows: list[Row] = []
    for path in folders:
        folder = ResultsFolder(pathlib.Path(path))
        agent = agent_of(folder)
        home = HERE if folder.load_config().get("backend") == HERE else THERE
        away = HERE if home == THERE else THERE
        keys = able_to_play(folder, say)
        with make_pool(home, episodes) as known, make_pool(away, episodes) as strange:
            examiners = HostExaminer(agent, known), HostExaminer(agent, strange)
            for key in keys[:: max(len(keys) // runs, 1)][:runs]:
                spec, snapshot = load_trained(agent, folder, key)
                means = []
                for examiner in examiners:
                    tests = play_trial(
                        examiner, Trial("autonomous", spec, [snapshot], examiner.num_episodes)
                    )
                    means.append(np.mean([row["return"] for row in tests]))
                rows.append(
                    {
                        "trained in": f"{_name(home)}: {key}",
                        "episodes": episodes,
                        "mean there": round(float(means[0]), 1),
                        f"mean in {_name(away)}": round(float(means[1]), 1),
                        "kept": f"{100 * means[1] / means[0]:.1f} %",
                        "bar": "95 %",
                    }
                )
    return rows


def distance(first: np.ndarray, second: np.ndarray) -> float:
    """The Kolmogorov-Smirnov distance of two samples: the most by which their shares differ."""
    points = np.concatenate([first, second])
    shares = [np.searchsorted(np.sort(x), points, side="right") / len(x) for x in (first, second)]
    return float(np.abs(shares[0] - shares[1]).max())


def _name(backend: str) -> str:
    return "Box2D" if backend == THERE else "hitl_jax.walker"


def _scripted_returns(pool: WalkerPool, episodes: int) -> np.ndarray:
    """Returns [episodes]; an episode begins as soon as a walker is free."""
    source = actions.scripted_walker()
    key = make_key(0)

    def act(states: Any, observation: jax.Array) -> tuple[Any, jax.Array]:
        return jax.vmap(lambda state, seen: source.act(state, seen, key))(states, observation)

    acting: Callable[..., tuple[Any, jax.Array]] = jax.jit(act)
    num = pool.num_walkers
    fresh = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (num, *leaf.shape)), source.init())
    states = jax.tree.map(np.array, fresh)
    episode = np.arange(num)
    begins = np.ones(num, bool)
    totals = np.zeros(episodes)
    observation = np.zeros((num, pool.observation_size), np.float32)
    begun = num
    while (episode < episodes).any():
        after, action = acting(states, observation)
        playing = episode < episodes
        command = np.where(begins, Command.RESET, Command.STEP)
        command = np.where(playing, command, Command.IDLE).astype(np.uint8)
        seeds = (_FIRST_SEED + episode).astype(np.uint32)
        answer = pool.step(command, np.array(action), seeds)
        states = _chosen(begins, fresh, after)
        observation = answer.observation
        totals[episode[playing]] += answer.reward[playing]
        begins = answer.terminated | answer.truncated
        for walker in np.flatnonzero(begins & playing).tolist():
            episode[walker] = begun
            begun += 1
    return totals


def _chosen(condition: np.ndarray, first: Any, second: Any) -> Any:
    """The first where a condition [N] holds, else the second; leaves [N]."""
    return jax.tree.map(lambda a, b: np.where(condition, a, b), first, second)
