"""What alarms at any boundary would have told of trained walkers."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hitl_jax.analysis import alarm_figures, warning_figures
from hitl_jax.analysis.alarms import AlarmCounts, count_alarms, total
from hitl_jax.analysis.early_warnings import (
    count_precision,
    count_reliability,
    count_warnings,
    steps_to_fall,
)
from hitl_jax.analysis.warning_figures import LEARNED
from hitl_jax.config import RunHyper, traced
from hitl_jax.errors import ResultsError
from hitl_jax.evaluation.host import HostExaminer, play_trial
from hitl_jax.evaluation.trials import Trial
from hitl_jax.human.experience import expectation
from hitl_jax.human.foresight import overreach
from hitl_jax.human.indicator import INDICATORS, WALKER_OBSERVATION, Indicator
from hitl_jax.playback.episodes import playing_pool
from hitl_jax.playback.load_trained import able_to_play, agent_of, load_trained
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.episode_tables import rows_to_csv
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import RunSpec, Snapshot
from hitl_jax.types import Behavior

NUM_BOUNDARIES = 61
"""From 0 to the greatest boundary that the runs could have."""

_BESIDE: dict[str, Indicator] = {
    "hull_angle": INDICATORS.make("hull_angle"),
    "weighted": INDICATORS.make("weighted"),
    "human_overreach": lambda seen: jnp.maximum(overreach(seen), 0.0),
    "human_expectation": expectation,
}
"""What is told of every BipedalWalker, beside the run's own indicator: other indicators, the
overreach of the danger model `foresight`, and the expectation of `experienced`."""


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
    tables: dict[str, list[dict[str, Any]]] = {
        alarm_figures.DATA: [],
        warning_figures.WARNINGS: [],
        warning_figures.PRECISION: [],
        warning_figures.RELIABILITY: [],
    }
    with playing_pool(folder, agent, episodes) as pool:
        examiner, tell = HostExaminer(agent, pool), _indicators(agent)
        for number, key in enumerate(keys, start=1):
            spec, end = load_trained(agent, folder, key)
            walks = _walk(tell, agent, examiner, spec, end)
            boundaries = np.linspace(0.0, spec.hyper.boundary_high, NUM_BOUNDARIES)
            counts = walks.alarms(boundaries)
            run = {"method": key.method, "seed": key.seed}
            tables[alarm_figures.DATA] += _rows(run, boundaries, counts)
            tables[warning_figures.WARNINGS] += walks.told(run, count_warnings)
            tables[warning_figures.PRECISION] += walks.told(run, count_precision)
            reliability = walks.reliability(agent.config.risk_horizon)
            tables[warning_figures.RELIABILITY] += [run | row for row in reliability]
            say(f"{number}/{len(keys)} {key}: {counts.falls} falls")
    for name, columns in _COLUMNS.items():
        write_text_atomic(folder.path / name, rows_to_csv(tables[name], columns))


_COLUMNS = {
    alarm_figures.DATA: alarm_figures.COLUMNS,
    warning_figures.WARNINGS: warning_figures.WARNING_COLUMNS,
    warning_figures.PRECISION: warning_figures.PRECISION_COLUMNS,
    warning_figures.RELIABILITY: warning_figures.RELIABILITY_COLUMNS,
}


Count = Callable[[np.ndarray, np.ndarray], list[dict[str, Any]]]
"""Maps an indicator's size and the steps to a fall, [T] each, to rows."""


class _Walks(NamedTuple):
    """What the indicators told in the test episodes of a run.

    Attributes:
        own: name of the indicator that the run has.
        sizes: |c_t| of each episode, [T] each, by indicator; and, where π_θ is executed, how far
            the run's own is above it.
        fell: whether an episode ended in a fall.
    """

    own: str
    sizes: dict[str, list[np.ndarray]]
    fell: list[bool]

    def alarms(self, boundaries: np.ndarray) -> AlarmCounts:
        """What alarms of the run's own indicator told, at each of M boundaries."""
        episodes = zip(self.sizes[self.own], self.fell, strict=True)
        return total([count_alarms(size, fell, boundaries) for size, fell in episodes])

    def told(self, run: dict[str, Any], count: Count) -> list[dict[str, Any]]:
        """Rows of what is counted of each indicator."""
        return [
            run | {"indicator": name} | row
            for name, size in self._known().items()
            for row in count(np.concatenate(size), self._to_fall())
        ]

    def reliability(self, horizon: int) -> list[dict[str, Any]]:
        """Rows of `count_reliability`; none where the run has no risk critic."""
        if "fall_risk" not in self._known():
            return []
        risk = np.concatenate(self.sizes["fall_risk"])
        return count_reliability(risk, self._to_fall(), horizon)

    def _known(self) -> dict[str, list[np.ndarray]]:
        return {
            name: sizes
            for name, sizes in self.sizes.items()
            if all(np.isfinite(size).all() for size in sizes)
        }

    def _to_fall(self) -> np.ndarray:
        return steps_to_fall([len(size) for size in self.sizes[self.own]], self.fell)


Tell = Callable[[Behavior, RunHyper, np.ndarray], dict[str, jax.Array]]
"""Maps what acts, hyperparameters and observations [N, O] to |c_t| [N], by indicator; the own comes
first."""


def _indicators(agent: Agent) -> Tell:
    own = agent.config.indicator
    beside = _BESIDE if agent.config.observation_size == WALKER_OBSERVATION else {}
    others = {name: each for name, each in beside.items() if name != own}

    def tell(params: Behavior, hyper: RunHyper, seen: jax.Array) -> dict[str, jax.Array]:
        size = jnp.abs(agent.safety_indicator(params, seen))
        told = {own: size} | {name: jnp.abs(each(seen)) for name, each in others.items()}
        if agent.executes_actor:
            learned = agent.boundary_learner.boundary(traced(hyper), params.boundary_actor, seen)
            told[LEARNED] = jnp.where(hyper.learns_boundary > 0, size - learned, jnp.nan)
        return told

    return jax.jit(jax.vmap(tell, in_axes=(None, None, 0)))


def _walk(tell: Tell, agent: Agent, examiner: HostExaminer, spec: RunSpec, end: Snapshot) -> _Walks:
    steps: list[dict[str, np.ndarray]] = []

    def watch(decided: np.ndarray, active: np.ndarray) -> None:
        del active  # the rows tell how long each episode was
        seen = decided[:, agent.layout.observation]
        steps.append(jax.device_get(tell(end.behavior, spec.hyper, seen)))

    rows = play_trial(examiner, Trial("autonomous", spec, [end], examiner.num_episodes), watch)
    lengths = [row["length"] for row in rows]
    sizes = {
        name: [
            np.array([step[name][walker] for step in steps[:length]])
            for walker, length in enumerate(lengths)
        ]
        for name in steps[0]
    }
    own = agent.config.indicator
    if agent.risk_learner is not None and not spec.hyper.has_arbiter > 0:
        sizes[own] = [np.full_like(size, np.nan) for size in sizes[own]]  # Nobody has learned it.
    return _Walks(own, sizes, [bool(row["fall"]) for row in rows])


def _rows(run: dict[str, Any], boundaries: np.ndarray, counts: AlarmCounts) -> list[dict[str, Any]]:
    return [
        run
        | {
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
