"""Where HITL-AC's trained walkers are, and which boundary they have there."""

from collections.abc import Callable

import numpy as np

from hitl_jax.analysis.boundary_map import Cells
from hitl_jax.boundary import SOURCES
from hitl_jax.config import Method
from hitl_jax.errors import ResultsError
from hitl_jax.evaluation.host import HostExaminer, play_trial
from hitl_jax.evaluation.trials import Trial
from hitl_jax.human.indicator import WALKER_OBSERVATION
from hitl_jax.playback.episodes import playing_pool
from hitl_jax.playback.load_trained import able_to_play, agent_of, load_trained
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.agent import Agent

_VELOCITY_UNIT = 25.0  # rad/s; the observation is 2 ω / 50


def map_boundary(folder: ResultsFolder, episodes: int, say: Callable[[str], None]) -> None:
    """Plays the trained walkers alone, and writes the data of the map.

    Args:
        folder: of a sweep whose boundary an actor gives.
        episodes: test episodes of a run.
        say: is told of each run.

    Raises:
        ResultsError: one line, where there is nothing to map.
    """
    agent = agent_of(folder)
    if not agent.executes_actor:
        able = [name for name in SOURCES if SOURCES.make(name).executes_actor]
        raise ResultsError(
            f"{folder.path}: its boundary source is {agent.config.boundary_source}: must be one of "
            f"{', '.join(able)}, where an actor's output is executed"
        )
    size = agent.config.observation_size
    if size != WALKER_OBSERVATION:
        raise ResultsError(
            f"{folder.path}: its observations have {size} numbers: must be the walker's "
            f"{WALKER_OBSERVATION}, since the map is over hull angle and angular velocity"
        )
    keys = [key for key in able_to_play(folder, say) if key.method == Method.HITL_AC]
    if not keys:
        raise ResultsError(f"{folder.path}: no run of HITL-AC has finished yet")
    cells = Cells()
    with playing_pool(folder, agent, episodes) as pool:
        examiner = HostExaminer(agent, pool)
        for key in keys:
            visited = _visits(agent, examiner, folder, key)
            cells.add(visited)
            say(f"{key}: {len(visited):,} steps")
    cells.write(folder)


def _visits(agent: Agent, examiner: HostExaminer, folder: ResultsFolder, key: RunKey) -> np.ndarray:
    """Hull angle, angular velocity and boundary of every step of the tests, [T, 3]."""
    spec, end = load_trained(agent, folder, key)
    layout = agent.layout
    visited: list[np.ndarray] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        angle, velocity = decided[active, layout.observation][:, :2].T
        boundary = decided[active, layout.boundary]
        visited.append(np.column_stack([angle, velocity * _VELOCITY_UNIT, boundary]))

    play_trial(examiner, Trial("autonomous", spec, [end], examiner.num_episodes), watch)
    return np.concatenate(visited)
