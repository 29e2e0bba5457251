"""What alarms at any boundary would have told of trained walkers."""

import csv
import io
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from hitl_jax.analysis import alarm_figures
from hitl_jax.analysis.alarms import AlarmCounts, count_alarms, total
from hitl_jax.errors import ResultsError
from hitl_jax.evaluation.host import HostExaminer, play_trial
from hitl_jax.evaluation.trials import Trial
from hitl_jax.playback.episodes import playing_pool
from hitl_jax.playback.load_trained import able_to_play, agent_of, load_trained
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import RunSpec, Snapshot

NUM_BOUNDARIES = 61
"""From 0 to the greatest boundary that the runs could have."""


def write_alarms(folder: ResultsFolder, episodes: int, say: Callable[[str], None]) -> None:
    """Plays the trained walkers alone, and writes how well alarms foretold falls.

    Args:
        folder: of a sweep.
        episodes: test episodes of a run.
        say: is told of each run.

    Raises:
        ResultsError: one line, where there is nothing to play.
    """
    agent = agent_of(folder)
    keys = able_to_play(folder, say)
    if not keys:
        raise ResultsError(f"{folder.path}: no run has finished yet")
    rows: list[dict[str, Any]] = []
    with playing_pool(folder, agent, episodes) as pool:
        examiner = HostExaminer(agent, pool)
        for number, key in enumerate(keys, start=1):
            spec, end = load_trained(agent, folder, key)
            boundaries = np.linspace(0.0, spec.hyper.boundary_high, NUM_BOUNDARIES)
            counts = _count(agent, examiner, spec, end, boundaries)
            rows += _rows(key, boundaries, counts)
            say(f"{number}/{len(keys)} {key}: {counts.falls} falls")
    text = io.StringIO()
    writer = csv.DictWriter(text, alarm_figures.COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text_atomic(folder.path / alarm_figures.DATA, text.getvalue())


def _count(
    agent: Agent, examiner: HostExaminer, spec: RunSpec, end: Snapshot, boundaries: np.ndarray
) -> AlarmCounts:
    indicator = jax.jit(jax.vmap(agent.safety_indicator, in_axes=(None, 0)))
    sizes: list[np.ndarray] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        del active  # the rows tell how long each episode was
        observation = decided[:, agent.layout.observation]
        sizes.append(np.abs(np.asarray(indicator(end.behavior, observation))))

    rows = play_trial(examiner, Trial("autonomous", spec, [end], examiner.num_episodes), watch)
    played = np.array(sizes)
    return total(
        [
            count_alarms(played[: row["length"], walker], bool(row["fall"]), boundaries)
            for walker, row in enumerate(rows)
        ]
    )


def _rows(key: RunKey, boundaries: np.ndarray, counts: AlarmCounts) -> list[dict[str, Any]]:
    return [
        {
            "method": key.method,
            "seed": key.seed,
            "boundary": round(float(boundary), 6),
            "steps": counts.steps,
            "alarms": counts.alarms[place].item(),
            "timely_alarms": counts.timely_alarms[place].item(),
            "falls": counts.falls,
            "warned_falls": counts.warned_falls[place].item(),
            "lead_steps": counts.lead_steps[place].item(),
        }
        for place, boundary in enumerate(boundaries)
    ]
