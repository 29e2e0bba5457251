"""What a person sees while a sweep runs."""

import time
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from rich.live import Live
from rich.table import Table

from hitl_jax.console.output import plain_console
from hitl_jax.training.run_spec import Run

_REFRESH_SECONDS = 1.0
_FIRST_LINE_SECONDS = 5.0
_LINE_SECONDS = 30.0
_RATE_SECONDS = 60.0


class Progress:
    """Runs done, episodes, steps, rate, time left and the latest return of each method.

    On a terminal a table that is redrawn; elsewhere lines, the first ones soon, then one every half
    minute.
    """

    def __init__(self, methods: Sequence[str], num_runs: int, episodes: int, done: int):
        """Nothing is shown before `__enter__`.

        Args:
            methods: in the order of the table.
            num_runs: runs of the sweep, finished ones included.
            episodes: training episodes of all runs that are to be made.
            done: runs that were finished before.
        """
        self._methods = methods
        self._num_runs = num_runs
        self._episodes = episodes
        self._done = done
        self._finished: list[Run] = []
        self._console = plain_console()
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._due = -float("inf")
        self._history: list[tuple[float, int, int]] = []

    def __enter__(self) -> "Progress":
        """Starts the display."""
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the display."""
        if self._console.is_terminal:
            self._live.stop()

    def say(self, message: str) -> None:
        """Prints a line above the table."""
        self._console.print(message, soft_wrap=True)

    def finish(self, run: Run) -> None:
        """Counts a run as finished."""
        self._finished.append(run)

    def show(self, running: Sequence[Run]) -> None:
        """Shows the state of things, if it is time to.

        Args:
            running: the runs under way.
        """
        now = time.monotonic()
        if now < self._due:
            return
        finished = {run.spec.key for run in self._finished}
        left = [run for run in running if run.spec.key not in finished]
        runs = [*self._finished, *left]
        episodes = sum(len(run.episodes) for run in runs)
        steps = sum(run.env_steps for run in runs)
        self._history.append((now, episodes, steps))
        while self._history[-1][0] - self._history[0][0] > _RATE_SECONDS:
            self._history.pop(0)
        terminal = self._console.is_terminal
        pause = min(max(now - self._history[0][0], _FIRST_LINE_SECONDS), _LINE_SECONDS)
        self._due = now + (_REFRESH_SECONDS if terminal else pause)
        headline = self._headline(episodes, steps, sum(run.done for run in left))
        if terminal:
            self._live.update(self._table(headline, runs), refresh=True)
        else:
            latest = ", ".join(f"{m} {_latest(self._of(m, runs))}" for m in self._methods)
            self._console.print(f"{headline}; latest returns: {latest}", soft_wrap=True)

    def _of(self, method: str, runs: Sequence[Run]) -> list[Run]:
        return [run for run in runs if run.spec.method == method]

    def _headline(self, episodes: int, steps: int, untested: int) -> str:
        (then, episodes_then, steps_then), (now, *_) = self._history[0], self._history[-1]
        seconds = max(now - then, 1e-9)
        done = self._done + len(self._finished)
        tests = f", {untested} to be tested" if untested else ""
        total = self._episodes
        line = f"runs {done}/{self._num_runs}{tests}  episodes {episodes}/{total}  steps {steps:,}"
        if episodes in (episodes_then, total):
            return line
        left = (total - episodes) * seconds / (episodes - episodes_then)
        return f"{line}  {(steps - steps_then) / seconds:,.0f} steps/s  about {_clock(left)} left"

    def _table(self, headline: str, runs: Sequence[Run]) -> Table:
        table = Table(title=headline, title_justify="left", box=None, pad_edge=False)
        columns = ("method", "runs", "episodes", "steps", "last 20 returns", "boundary")
        for index, name in enumerate(columns):
            table.add_column(name, justify="right" if index else "left")
        counts: dict[str, int] = defaultdict(int)
        for run in self._finished:
            counts[run.spec.method] += 1
        for method in self._methods:
            mine = self._of(method, runs)
            boundary = [run.episodes[-1]["final_boundary"] for run in mine if run.episodes]
            table.add_row(
                method,
                f"{counts[method]}/{len(mine)}",
                str(sum(len(run.episodes) for run in mine)),
                f"{sum(run.env_steps for run in mine):,}",
                _latest(mine),
                f"{np.mean(boundary):.3f}" if boundary else "",
            )
        return table


def _latest(runs: Sequence[Run]) -> str:
    """Mean of the last 20 returns of each run; a dash before the first episode."""
    means = [np.mean([row["return"] for row in run.episodes[-20:]]) for run in runs if run.episodes]
    return f"{np.mean(means):.0f}" if means else "–"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"
