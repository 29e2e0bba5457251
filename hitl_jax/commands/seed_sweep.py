"""The main job: `hitl-jax sweep`.

Trains SRL, HITL-FIX and HITL-AC over a batch of seeds on BipedalWalker-v3, tests each trained
walker, and writes tables and Figures 4 to 6. Started again in the same folder it goes on where it
was.
"""

import contextlib
import dataclasses
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from hitl_jax.analysis import figures, stats
from hitl_jax.analysis.summary import write_summary
from hitl_jax.console.cli import checking_input
from hitl_jax.console.progress import Progress
from hitl_jax.envs import box2d, default_backend, make_pool, require_backend
from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.errors import BadInput, LaunchError, ResultsError
from hitl_jax.human.judgement import recorded
from hitl_jax.results.atomic_files import locked
from hitl_jax.results.episode_measures import ALARM_WINDOW, LOST_TESTS, num_lost
from hitl_jax.results.episode_tables import (
    EPISODE_COLUMNS,
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
    to_columns,
)
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep import recorded_human
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.launchers import Launcher
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.sweep.signals import Interrupted
from hitl_jax.sweep.train_and_test import Batch, Plant, Tested, make_team, policy_digest
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import Agent
from hitl_jax.training.run_spec import Run

FIRST_FIGURES_SECONDS = 100.0
FIGURES_SECONDS = 300.0
FIGURES_NICE = 10
"""Added to the process's own: a drawing must not keep walkers waiting."""


def main(options: SweepOptions) -> int:
    """Runs a sweep.

    Args:
        options: what to run.

    Returns:
        The exit code: 0, 130 after Ctrl-C, or 143 after SIGTERM.
    """
    with contextlib.ExitStack() as held:
        with checking_input():
            options, note = _with_backend(options.checked())
            dangerous = recorded_human.load(options.human)
            judge = None if dangerous is None else recorded(dangerous)
            agent = make_team(options.agent, options.human_policy, judge)
            folder = ResultsFolder(options.out)
            config = _config(options) | recorded_human.digest(dangerous)
            held.enter_context(options.launch.ready())
            if note:
                print(note, flush=True)
            command = shlex.join(["hitl-jax", "sweep", *sys.argv[1:]])
            try:
                held.enter_context(locked(folder.path))
                part = options.part()
                changed = folder.create_or_resume(config, command, part and part._asdict())
                folder.require_free(spec.key for spec in options.specs())
                recorded_human.keep(folder.path, dangerous)
            except ResultsError as error:
                raise BadInput(f"--out {error}") from error
        if changed:
            print(f"{options.out} was begun with {'; '.join(changed)}", flush=True)
        keep_programs()
        return _Sweep(options, agent, folder, config).run()


def _with_backend(options: SweepOptions) -> tuple[SweepOptions, str]:
    """The options with a backend that can be had here, and a line to be said if it is not lean.

    Raises:
        ImportError: one line that says what to install for the backend that is asked for.
    """
    if options.backend is not None:
        require_backend(options.backend)
        if options.backend == "envpool":
            make_pool("envpool", 1).close()  # A missing extra is noticed before a folder is made.
        return options, ""
    chosen = default_backend()
    note = (
        "" if chosen == "lean" else f"Box2D cannot be imported ({box2d.missing()}): --backend jax"
    )
    return dataclasses.replace(options, backend=chosen), note


class _Sweep:
    """The runs that are left to do, with all that happens around them."""

    def __init__(
        self, options: SweepOptions, agent: Agent, folder: ResultsFolder, config: dict[str, Any]
    ):
        self._options = options
        self._folder = folder
        self._config = config
        wanted = options.specs()
        finished = folder.finished()
        specs = [spec for spec in wanted if spec.key not in finished]
        assert options.backend is not None
        plant = Plant(
            options.backend, options.slots, options.workers, options.scale().test_episodes
        )
        self._batch = Batch("under_way", agent, specs, options.loop, plant)
        self._running: Sequence[Run] = []
        self._drawing: subprocess.Popen | None = None
        self._draw_at = time.monotonic() + FIRST_FIGURES_SECONDS
        self._progress = Progress(
            options.methods, len(wanted), options.scale().episodes, len(wanted) - len(specs)
        )

    def run(self) -> int:
        """Makes the runs that the folder lacks, and draws; the exit code."""
        launcher = self._options.launch.make(
            self._folder.path,
            self._options.save_seconds,
            self._folder.finished,
            self._progress.say,
        )
        try:
            self._make(launcher)
        except Interrupted as stop:
            self._save_partial()
            draw(self._folder)
            print(
                f"\nStopped. Figures and tables of what there is: {self._options.out}. "
                f"{self._options.launch.goes_on}",
                flush=True,
            )
            return stop.exit_code
        except LaunchError:
            draw(self._folder)
            raise
        except ResultsError as error:
            if not self._running:
                raise  # Nothing has begun; what the error says is what is to be done.
            raise ResultsError(
                f"{error}. What was finished or saved before is kept; the same command goes on"
            ) from error
        for line in draw(self._folder):
            print(line)
        return 0

    def _make(self, launcher: Launcher) -> None:
        """Trains, tests and writes every run."""
        if self._batch.specs:
            self._progress.say(f"results: {self._options.out}")
        try:
            with (
                self._progress if self._batch.specs else contextlib.nullcontext(),
                contextlib.closing(launcher.make([self._batch], self._show)) as made,
            ):
                for tested in made:
                    self._finish(tested)
        finally:
            self._stop_drawing()

    def _show(self, running: Sequence[Run]) -> None:
        self._running = running
        self._progress.show(running)
        self._draw_now_and_then()

    def _save_partial(self) -> None:
        """Writes, for the figures, the episodes of the runs that are not finished."""
        finished = self._folder.finished()
        for run in self._running:
            key = run.spec.key
            if run.episodes and key not in finished:
                self._folder.write_partial(key, to_columns(run.episodes, EPISODE_COLUMNS))

    def _stop_drawing(self) -> None:
        """Ends a drawing that is under way: a folder has one writer."""
        if self._drawing is not None:
            self._drawing.terminate()
            self._drawing.wait()

    def _finish(self, tested: Tested) -> None:
        """Writes a trained and tested run."""
        run, key = tested.finished.run, tested.key
        info = {
            "config": self._config,
            "wall_seconds": tested.wall_seconds,
            "env_steps": run.env_steps,
            "updates": run.updates,
            "diverged": run.diverged and run.diverged._asdict(),
            "lost_tests": num_lost([*tested.tests, *tested.progress]),
            "commit": tested.commit,
            "versions": tested.versions,
            "machine": tested.machine,
        }
        self._folder.save_run(
            key,
            to_columns(run.all_episodes(), EPISODE_COLUMNS),
            to_columns(tested.tests, TEST_COLUMNS),
            checkpoint.flatten(tested.finished.train, tested.finished.boundary),
            info,
            to_columns(tested.progress, PROGRESS_COLUMNS),
            run.recordings,
        )
        self._folder.remove_partial(key)
        self._progress.finish(run)
        alone = [row["return"] for row in tested.tests if row["mode"] == "autonomous"]
        self._progress.say(
            f"finished {key.method} seed {key.seed}: {run.env_steps:,} steps, "
            f"test return {np.mean(alone):.1f} over {len(alone)} episodes"
            + (f"; diverged: {run.diverged}" if run.diverged else "")
            + (f"; {LOST_TESTS}: {info['lost_tests']}" if info["lost_tests"] else "")
        )

    def _draw_now_and_then(self) -> None:
        """Draws in another process, of lower priority, so that training does not wait."""
        if time.monotonic() < self._draw_at or (self._drawing and self._drawing.poll() is None):
            return
        self._save_partial()
        python, environment = child_interpreter()
        self._drawing = subprocess.Popen(
            [*python, "-m", "hitl_jax", "figures", self._options.out],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )
        with contextlib.suppress(ProcessLookupError):  # It may have ended already.
            os.setpriority(os.PRIO_PROCESS, self._drawing.pid, os.nice(0) + FIGURES_NICE)
        self._draw_at = time.monotonic() + FIGURES_SECONDS


def _config(options: SweepOptions) -> dict[str, Any]:
    """All that defines a run's numbers besides its method and seed."""
    return {
        "backend": options.backend,
        "episodes": options.scale().episodes,
        "test_episodes": options.scale().test_episodes,
        "alarm_window": ALARM_WINDOW,
        "human_policy": policy_digest(options.human_policy),
        "agent": dataclasses.asdict(options.agent),
        "loop": dataclasses.asdict(options.loop),
        "hyper": dataclasses.asdict(options.hyper),
    }


def draw(folder: ResultsFolder) -> list[Any]:
    """Writes summary and figures.

    Args:
        folder: of results.

    Returns:
        The paths written, and notes on what could not be drawn.
    """
    tables = write_summary(folder, np.random.default_rng(stats.SEED))
    return [*tables, *figures.draw_all(folder, np.random.default_rng(stats.SEED)).lines]
