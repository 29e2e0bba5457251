"""Summary and figures of a results folder: at the end, and now and then while a sweep runs."""

import contextlib
import os
import pathlib
import subprocess
import time
from collections.abc import Callable
from typing import Any

from hitl_jax.analysis import figures
from hitl_jax.analysis.summary import write_summary
from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.results.atomic_files import remove_leftovers
from hitl_jax.results.folder import ResultsFolder

FIRST_FIGURES_SECONDS = 100.0
FIGURES_SECONDS = 300.0
FIGURES_NICE = 10
"""Added to the process's own: a drawing must not keep walkers waiting."""


def draw(folder: ResultsFolder) -> list[Any]:
    """Writes summary and figures.

    Args:
        folder: of results.

    Returns:
        The paths written, and notes on what could not be drawn.
    """
    runs = folder.load_all()
    return [*write_summary(folder, runs), *figures.draw_all(folder, runs).lines]


class BackgroundFigures:
    """Draws in another process, of lower priority, so that training does not wait.

    Args:
        folder: of the results.
        prepare: called before a drawing begins; writes what it is to show.
    """

    def __init__(self, folder: pathlib.Path, prepare: Callable[[], None]):
        self._folder, self._prepare = folder, prepare
        self._drawing: subprocess.Popen | None = None
        self._draw_at = time.monotonic() + FIRST_FIGURES_SECONDS

    def draw_if_due(self) -> None:
        """Begins a drawing if it is time to, and the one before has ended."""
        if time.monotonic() < self._draw_at or (self._drawing and self._drawing.poll() is None):
            return
        self._prepare()
        python, environment = child_interpreter()
        self._drawing = subprocess.Popen(
            [*python, "-m", "hitl_jax", "figures", str(self._folder)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )
        with contextlib.suppress(ProcessLookupError):  # It may have ended already.
            os.setpriority(os.PRIO_PROCESS, self._drawing.pid, os.nice(0) + FIGURES_NICE)
        self._draw_at = time.monotonic() + FIGURES_SECONDS

    @property
    def drawing(self) -> subprocess.Popen | None:
        """The process that draws, or has drawn last; None before the first."""
        return self._drawing

    def draw_now(self) -> None:
        """Begins a drawing at once, unless one is under way."""
        self._draw_at = time.monotonic()
        self.draw_if_due()

    def stop(self) -> None:
        """Ends a drawing that is under way: a folder has one writer."""
        if self._drawing is not None:
            self._drawing.terminate()
            self._drawing.wait()
            remove_leftovers(self._folder / "figures")
