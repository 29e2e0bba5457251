"""The test phase (Fig. 5): which policies of a run are tested, on which terrains, in which mode."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, Protocol

import jax
import numpy as np

from hitl_jax.arbiter import INTERVENTIONS
from hitl_jax.config import Method, RunHyper
from hitl_jax.results.episode_measures import Row, fall_at_once
from hitl_jax.team.acting import ActingState, init_acting
from hitl_jax.team.agent import Agent, behavior
from hitl_jax.training import batch_arrays
from hitl_jax.training.run_spec import (
    FinishedRun,
    Run,
    RunSpec,
    Snapshot,
    episode_seed,
    method_index,
)

Mode = Literal["autonomous", "assisted"]

MOST_TEST_EPISODES = 10_000
"""Of one test: the host's examiner has a walker for each."""

_PARTS = 20


class Trial(NamedTuple):
    """A test of some of a run's policies, each on the same terrains.

    Attributes:
        mode: `autonomous` or `assisted`.
        spec: the run.
        policies: to be tested, K.
        episodes: of each policy.
    """

    mode: Mode
    spec: RunSpec
    policies: Sequence[Snapshot]
    episodes: int


class Examiner(Protocol):
    """Plays trials.

    Attributes:
        num_episodes: of one test.
        num_runs: how many it likes to be given at a time, for the sake of speed.
    """

    num_episodes: int
    num_runs: int

    def play(self, trials: Sequence[Trial], between: Callable[[], None]) -> list[list[Row]]:
        """Plays trials.

        Args:
            trials: of any runs.
            between: called every now and then; may raise to break off.

        Returns:
            Of each trial a row for each policy and episode, policy after policy.
        """
        ...


def milestones(episodes: int) -> tuple[int, ...]:
    """Numbers of training episodes at which a run is tested before its end: 1/20 to 19/20 of it."""
    points = (episodes * part // _PARTS for part in range(1, _PARTS))
    return tuple(sorted({point for point in points if point > 0}))


def as_tested(agent: Agent) -> Agent:
    """The team in a test, where no intervention is a reset."""
    config = dataclasses.replace(agent.config, intervention="takeover")
    return agent._replace(config=config, intervention=INTERVENTIONS.make("takeover"))


def init_test(
    agent: Agent, hyper: RunHyper, boundary: jax.Array, key: jax.Array, episode: jax.Array
) -> ActingState:
    """Acting at the first step of a test episode; its key depends on nothing else.

    Args:
        agent: the team.
        hyper: scalars.
        boundary: the boundary source's carry, [] or [C].
        key: of the run's tests, [].
        episode: its number from 0 on, [].
    """
    state = init_acting(agent, hyper, jax.random.fold_in(key, episode))
    return dataclasses.replace(state, boundary=boundary)


def evaluate_runs(
    examiner: Examiner,
    runs: Sequence[FinishedRun],
    modes: Callable[[Method], Sequence[Mode]],
    between: Callable[[], None] = lambda: None,
) -> list[tuple[list[Row], list[Row]]]:
    """Tests runs as training left them, and as they were at their snapshots.

    The terrain depends on the seed alone: a comparison that is paired over methods needs fewer
    episodes. Of N episodes of a test each of K snapshots gets ⌊N / K⌋ in each mode, at least one,
    on the first terrains of the test at the end. A run that diverged counts as falling at once.

    Args:
        examiner: plays the episodes.
        runs: that have ended.
        modes: which tests, in this order, by method.
        between: see `Examiner.play`.

    Returns:
        Of each run a row for each mode and episode; and one for each snapshot and episode, with
        the number of training episodes as `trained`.
    """
    each = examiner.num_episodes
    final = [_final(run, modes(run.run.spec.method), each) for run in runs]
    earlier = [_earlier(run.run, modes(run.run.spec.method), each) for run in runs]
    asked = [trial for trials in [*final, *earlier] for trial in trials]
    played = iter(examiner.play(asked, between))
    at_end = [[row for _ in trials for row in next(played)] for trials in final]
    on_the_way = [
        [row for trial in trials for row in _with_trained(run.run, trial, next(played))]
        for run, trials in zip(runs, earlier, strict=True)
    ]
    return list(zip(at_end, on_the_way, strict=True))


def _final(finished: FinishedRun, modes: Sequence[Mode], episodes: int) -> list[Trial]:
    """The tests of a run as training left it."""
    spec = finished.run.spec
    last = Snapshot(spec.episodes, behavior(finished.kept), finished.boundary)
    return [Trial(mode, spec, [last], episodes) for mode in modes]


def _earlier(run: Run, modes: Sequence[Mode], episodes: int) -> list[Trial]:
    """The tests of a run's snapshots, which share the episodes of a test."""
    each = max(episodes // max(len(run.snapshots), 1), 1)
    groups = [
        run.snapshots[first : first + episodes] for first in range(0, len(run.snapshots), episodes)
    ]
    return [Trial(mode, run.spec, group, each) for mode in modes for group in groups]


def _with_trained(run: Run, trial: Trial, rows: Sequence[Row]) -> list[Row]:
    """Rows of a test of snapshots, each with the training episodes before it as `trained`."""
    lost = run.diverged.episodes if run.diverged else run.spec.episodes
    rows_of_all = []
    for number, row in enumerate(rows):
        trained = trial.policies[number // trial.episodes].episode
        rows_of_all.append({"trained": trained, **row} | (fall_at_once() if trained > lost else {}))
    return rows_of_all


def terrain_seeds(spec: RunSpec, episodes: range) -> np.ndarray:
    """Reset seeds of a run's test episodes, the same for all methods, uint32 [E]."""
    seeds = [episode_seed("test", spec.seed, number) for number in episodes]
    return np.array(seeds, np.uint32)


def trial_key(spec: RunSpec) -> jax.Array:
    """The key of a run's tests, []."""
    *_, key = batch_arrays.run_keys(spec.seed, method_index(spec.method))
    return key


def frozen(hyper: RunHyper, human_present: bool) -> RunHyper:
    """The hyperparameters of a test: no exploration, no feedback, no movement of the boundary."""
    return dataclasses.replace(
        hyper,
        human_present=float(human_present),
        feedback=0.0,
        exploration_noise=0.0,
        final_noise=0.0,
        boundary_noise=0.0,
        unattended_every=0,
        warmup_steps=0,
        delta_minus=0.0,
        delta_plus=0.0,
    )
