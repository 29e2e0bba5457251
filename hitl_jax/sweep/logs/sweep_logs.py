"""The logs of all runs of a sweep, kept up with the runs."""

import functools
import math
import pathlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from hitl_jax.errors import is_told_to_end, said_by
from hitl_jax.results.diagnostic_table import COUNTERS
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.logs.run_log import LOGS, LoggedRun, RunLog
from hitl_jax.training.run_spec import Run


class SweepLogs:
    """Writes what comes of each run into its logs.

    A run that was interrupted is logged anew from its first episode: its save has all of them. A
    log that fails is given up, and that is said: no run is lost by it.
    """

    def __init__(
        self,
        names: Sequence[str],
        folder: pathlib.Path,
        config: dict[str, Any],
        say: Callable[[str], None],
    ):
        """Opens nothing yet.

        Args:
            names: of `LOGS`.
            folder: of the results.
            config: all that defines a run's numbers besides its method and seed.
            say: is told of a log that fails.
        """
        self._names, self._folder, self._config, self._say = list(names), folder, config, say
        self._open: dict[tuple[RunKey, str], RunLog] = {}
        self._written: dict[tuple[RunKey, str], tuple[int, int]] = {}

    def follow(self, runs: Iterable[Run]) -> None:
        """Writes what is new of runs: their episodes, and the diagnostics of their learners."""
        for run in runs if self._names else ():
            for name in list(self._names):
                self._do(name, functools.partial(self._follow, run, name))

    def _follow(self, run: Run, name: str) -> None:
        key = run.spec.key
        episodes, diagnostics = self._written.get((key, name), (0, 0))
        if len(run.episodes) < episodes:  # Another machine begins it anew.
            self._open.pop((key, name)).close()
            episodes = diagnostics = 0
        log = self._log_of(key, name)
        for row in run.episodes[episodes:]:
            _write(log, of_episode(row), row["env_steps"])
        for sample in run.diagnostics[diagnostics:]:
            _write(log, of_diagnostics(sample), sample["env_steps"])
        self._written[key, name] = len(run.episodes), len(run.diagnostics)

    def finish(self, run: Run, tests: Sequence[Row], progress: Sequence[Row]) -> None:
        """Writes the tests of a run that has ended, and closes its logs.

        Args:
            run: the run.
            tests: rows of its tests at the end.
            progress: rows of its tests before.
        """
        self.follow([run])
        for name in list(self._names):
            self._do(name, functools.partial(self._finish, run, tests, progress, name))

    def _finish(self, run: Run, tests: Sequence[Row], progress: Sequence[Row], name: str) -> None:
        log, episodes = self._log_of(run.spec.key, name), run.all_episodes()
        for what, rows in (("test", progress), ("test_at_the_end", tests)):
            for (mode, trained), returns in _returns(rows, len(episodes)).items():
                values = {f"2_return/{mode}_{what}": math.fsum(returns) / len(returns)}
                _write(log, values, episodes[trained - 1]["env_steps"] if trained else 0)
        self._open.pop((run.spec.key, name)).close()

    def close(self) -> None:
        """Closes the logs of runs that have not ended."""
        for (_, name), log in self._open.items():
            self._do(name, log.close)
        self._open.clear()

    def _log_of(self, key: RunKey, name: str) -> RunLog:
        if (key, name) not in self._open:
            run = LoggedRun(self._folder, key, self._config)
            self._open[key, name] = LOGS.make(name, run)
        return self._open[key, name]

    def _do(self, name: str, action: Callable[[], None]) -> None:
        """Does something with a log of this name; gives all of them up if that fails."""
        try:
            action()
        except Exception as error:  # Whatever a library or a disk does.
            if is_told_to_end(error):
                raise
            if name in self._names:
                self._names.remove(name)
            self._say(f"log {name}: {said_by(error)}; no more is logged there")


def _write(log: RunLog, values: Mapping[str, float], step: int) -> None:
    known = {name: float(value) for name, value in values.items() if math.isfinite(value)}
    log.write(known, int(step))


def _returns(rows: Sequence[Row], last: int) -> dict[tuple[str, int], list[float]]:
    """Returns of tests, by mode and by the training episodes before them."""
    found: dict[tuple[str, int], list[float]] = {}
    for row in rows:
        found.setdefault((row["mode"], row.get("trained", last)), []).append(row["return"])
    return found


def of_episode(row: Mapping[str, Any]) -> dict[str, float]:
    """What is logged of a training episode: first what a person who watches wants to see.

    Args:
        row: of episodes.csv.
    """
    alarms = row["true_alarms"] + row["false_alarms"]
    return {
        "1_human/intervention_rate": row["human_steps"] / row["length"],
        "1_human/interventions": row["interventions"],
        "1_human/steps": row["human_steps"],
        "2_return/training": row["return"],
        "2_return/training_shaped": row["shaped_return"],
        "2_return/length": row["length"],
        "2_return/fall": row["fall"],
        "3_alarms/count": row["alarms"],
        "3_alarms/confirmed_share": row["true_alarms"] / alarms if alarms else math.nan,
        "4_boundary/mean": row["mean_boundary"],
        "4_boundary/last": row["final_boundary"],
    }


def of_diagnostics(sample: Mapping[str, Any]) -> dict[str, float]:
    """What is logged of a sample of a run's learners.

    Args:
        sample: of diagnostics.csv.
    """
    return {f"5_learner/{name}": value for name, value in sample.items() if name not in COUNTERS}
