"""Notes of runs that wait for the learner: samples of `team.diagnostics`, and snapshots.

The learner is asked for them when they are due, and they are noted when it has them, so that the
host loop does not wait.
"""

from collections import deque
from collections.abc import Callable, Sequence

import chex
import numpy as np

from hitl_jax.learner.losses import Metrics
from hitl_jax.results.episode_measures import Row
from hitl_jax.team.diagnostics import on_host
from hitl_jax.training.learner_queue import LearnerQueue
from hitl_jax.training.run_spec import Run, Snapshot


class LateNotes:
    """What has been asked for and is not noted yet.

    Args:
        learner: that is asked.
        slots: R.
    """

    def __init__(self, learner: LearnerQueue, slots: int):
        self._learner = learner
        self._diagnosed: deque[tuple[list[tuple[Run, Row]], Metrics]] = deque()
        # Runs, episodes after which they are kept, rows of parameters, boundaries.
        self._snapshots: deque[tuple[Run, list[int], chex.Array, np.ndarray]] = deque()
        self._num_due = np.zeros(slots, int)
        self._to_diagnose: list[tuple[Run, Row]] = []

    def ask_snapshots(self, run: Run, boundary: Callable[[Run], np.ndarray]) -> None:
        """Asks for the snapshots whose episodes have ended; there may be several.

        Args:
            run: one that has a slot.
            boundary: gives the carry of its boundary source.
        """
        left = run.spec.snapshots[len(run.snapshots) + self._num_due[run.slot] :]
        due = [episode for episode in left if episode <= len(run.episodes) or run.diverged]
        if due:
            row = self._learner.tested_of(run.slot)
            self._snapshots.append((run, due, row, boundary(run)))
            self._num_due[run.slot] += len(due)

    def diagnose_later(self, due: Sequence[Run]) -> None:
        """Has samples of runs' learners taken as they are after the calls so far."""
        self._to_diagnose += [(run, run.counters()) for run in due]

    def ask_diagnostics(self) -> None:
        """Asks for the samples that are due; before the next call of the learner.

        Not when they are due: a call that has just been deferred would be made alone for them.
        """
        due = {run.slot: (run, row) for run, row in self._to_diagnose}
        self._to_diagnose = []
        for slots, metrics in self._learner.diagnose(list(due)):
            self._diagnosed.append(([due[slot] for slot in slots], metrics))

    def note(self, wait: bool) -> None:
        """Notes what is there, or all, in its order."""
        if wait:
            self.ask_diagnostics()
        while self._snapshots and (wait or self._snapshots[0][2].is_ready()):
            run, due, row, boundary = self._snapshots.popleft()
            [learned] = self._learner.behaviors(np.asarray(row)[None])
            run.snapshots += [Snapshot(episode, learned, boundary) for episode in due]
            self._num_due[run.slot] -= len(due)
        while self._diagnosed:
            rows, metrics = self._diagnosed[0]
            if not (wait or all(value.is_ready() for value in metrics.values())):
                return
            self._diagnosed.popleft()
            for (run, row), measured in zip(rows, on_host(metrics, len(rows)), strict=True):
                run.diagnostics.append(row | measured)
