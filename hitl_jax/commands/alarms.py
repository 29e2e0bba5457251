"""How well alarms foretell falls: `hitl-jax alarms RESULTS`.

Plays the trained walkers of a results folder once more, alone, on the terrains of their tests (of
EnvPool's, which cannot be had again, on others), and counts for a range of boundaries what alarms
at |c_t| >= τ would have told: how often they come, how many are followed by a fall, how many falls
they announce, and how long before.
"""

import contextlib
import csv
import dataclasses
import io
import pathlib
from typing import Any

import jax
import numpy as np
import tyro

from hitl_jax.analysis import alarm_figures
from hitl_jax.analysis.alarms import AlarmCounts, count_alarms, total
from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input, print_drawn
from hitl_jax.envs import make_pool
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.evaluation.host import Evaluator, evaluate_policies
from hitl_jax.playback.episodes import playing_backend
from hitl_jax.playback.load_trained import able_to_play, agent_of, load_trained
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import RunSpec, Snapshot

NUM_BOUNDARIES = 61
"""From 0 to the greatest boundary that the runs could have."""


@dataclasses.dataclass(frozen=True)
class AlarmOptions:
    """Counts alarms and falls of trained walkers; writes RESULTS/alarms.csv and figure 8.

    Attributes:
        results: a folder that a sweep has written.
        episodes: test episodes of a run.
    """

    results: tyro.conf.Positional[pathlib.Path]
    episodes: int = 100


def main(options: AlarmOptions) -> int:
    """Plays, writes and draws.

    Args:
        options: what to play.

    Returns:
        The exit code: 0, or 1 if the figure could not be drawn.

    Raises:
        BadInput: where there is nothing to play.
    """
    with checking_input():
        require("episodes", options.episodes, at_least=1)
    try:
        folder = ResultsFolder(options.results)
        agent = agent_of(folder)
        keys = able_to_play(folder)
        if not keys:
            raise BadInput(f"{options.results}: no run has finished yet")
        keep_programs()
        rows: list[dict[str, Any]] = []
        with contextlib.closing(make_pool(playing_backend(folder), options.episodes)) as pool:
            evaluator = Evaluator(agent, pool)
            for number, key in enumerate(keys, start=1):
                spec, end = load_trained(agent, folder, key)
                boundaries = np.linspace(0.0, spec.hyper.boundary_high, NUM_BOUNDARIES)
                counts = _count(agent, evaluator, spec, end, boundaries)
                rows += _rows(key, boundaries, counts)
                print(f"{number}/{len(keys)} {key}: {counts.falls} falls", flush=True)
        text = io.StringIO()
        writer = csv.DictWriter(text, alarm_figures.COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text_atomic(options.results / alarm_figures.DATA, text.getvalue())
        drawn = alarm_figures.draw(folder)
    except ResultsError as error:
        raise BadInput(str(error)) from error
    return print_drawn(drawn)


def _count(
    agent: Agent, evaluator: Evaluator, spec: RunSpec, end: Snapshot, boundaries: np.ndarray
) -> AlarmCounts:
    indicator = jax.jit(jax.vmap(agent.indicator))
    sizes: list[np.ndarray] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        del active  # the rows tell how long each episode was
        observation = decided[:, agent.layout.observation]
        sizes.append(np.abs(np.asarray(indicator(observation))))

    rows = evaluate_policies(evaluator, "autonomous", spec, [end], watch)
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
