"""A sweep in a results folder: its runs are made, tested and written; what is there is kept.

Started again in the same folder it goes on where it was.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from hitl_jax.choices.checks import require_default
from hitl_jax.choices.registry import is_imported
from hitl_jax.envs import OUR_WALKERS, WALKER, box2d, default_backend, make_pool, require_backend
from hitl_jax.envs.base import require_sizes
from hitl_jax.errors import LaunchError, ResultsError
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
from hitl_jax.sweep import fitted_human, recorded_human
from hitl_jax.sweep.background_figures import BackgroundFigures, draw
from hitl_jax.sweep.launchers import Launcher
from hitl_jax.sweep.logs import SweepLogs
from hitl_jax.sweep.options import SweepOptions
from hitl_jax.sweep.signals import Interrupted
from hitl_jax.sweep.train_and_test import Batch, Tested, Walkers, make_team, policy_digest
from hitl_jax.tasks import facts, task_of
from hitl_jax.team import checkpoint
from hitl_jax.team.agent import Agent, validate
from hitl_jax.training.run_spec import Run


class Display(Protocol):
    """Shows a person how a sweep goes on, within a `with`."""

    def __enter__(self) -> Any:
        """Begins to show."""

    def __exit__(self, *error: object) -> None:
        """Ends."""

    def say(self, message: str) -> None:
        """Tells one line."""

    def finish(self, run: Run) -> None:
        """Counts a run as finished."""

    def show(self, running: Sequence[Run]) -> None:
        """Is told after each chunk how the runs under way stand."""


class Prepared(NamedTuple):
    """A sweep whose options are checked and whose folder is there.

    Attributes:
        options: with the backend that is used.
        agent: the team.
        folder: of the results, locked.
        config: all that defines a run's numbers besides its method and seed.
    """

    options: SweepOptions
    agent: Agent
    folder: ResultsFolder
    config: dict[str, Any]

    @property
    def num_missing(self) -> int:
        """How many of the runs that are asked for the folder lacks."""
        finished = self.folder.finished()
        return sum(spec.key not in finished for spec in self.options.specs())


@contextlib.contextmanager
def prepared(options: SweepOptions, command: str, say: Callable[[str], None]) -> Iterator[Prepared]:
    """Checks the options, and makes or opens the folder for this process alone.

    Args:
        options: what to run.
        command: kept in the folder.
        say: is told what a person should know before the runs begin.

    Raises:
        ValueError: one line, for an option that is not allowed.
        ImportError: one line, for a backend that is not installed.
        ResultsError: one line, if the folder cannot be used.
    """
    options, note = with_backend(options.checked())
    fitted = fitted_human.load(options.human)
    dangerous = recorded_human.load(options.human) if fitted is None else None
    judge, source = None if dangerous is None else recorded(dangerous), None
    if fitted is not None:
        judge, source = fitted.judge, fitted.source
    if source is not None:
        usual = options.of_preset(options.preset, options.human_preset, options.env)
        why = "has no meaning beside human fitted:FILE, which has hands"
        require_default(options.agent, usual.agent, ("human_actions",), why, mentions=("human",))
    agent = make_team(options.agent, options.human_policy, judge, source)
    validate(agent, options.hyper)
    options = dataclasses.replace(options, hyper=agent.with_extra(options.hyper))
    folder = ResultsFolder(options.out)
    config = config_of(options) | recorded_human.digest(dangerous) | fitted_human.digest(fitted)
    with options.launch.ready(), contextlib.ExitStack() as held:
        if note:
            say(note)
        held.enter_context(locked(folder.path))
        part = options.part()
        changed = folder.create_or_resume(config, command, part and part._asdict())
        folder.require_free(spec.key for spec in options.specs())
        recorded_human.save_to_results(folder.path, dangerous)
        fitted_human.save_to_results(folder.path, fitted)
        if changed:
            say(f"{options.out} was begun with {'; '.join(changed)}")
        yield Prepared(options, agent, folder, config)


def with_backend(options: SweepOptions) -> tuple[SweepOptions, str]:
    """The options with a backend that can be had here, and a line to be said if it is not lean.

    Raises:
        ImportError: one line that says what to install for the backend that is asked for.
        InvalidValue: one line, if its walkers have other sizes than the team.
    """
    played, note = task_of(options.env).env_id, ""
    if options.backend is None:
        options = dataclasses.replace(options, backend=default_backend(played))
        if options.backend == "jax":
            note = f"Box2D cannot be imported ({box2d.missing()}): --backend jax"
    assert options.backend is not None
    require_backend(options.backend, played)
    if options.backend == "envpool" or is_imported(options.backend) or played not in OUR_WALKERS:
        # What is missing or does not fit is noticed before a folder is made.
        with contextlib.closing(make_pool(options.backend, 1, env_id=options.env)) as pool:
            require_sizes(pool, options.agent.observation_size, options.agent.action_size)
    return options, note


def config_of(options: SweepOptions) -> dict[str, Any]:
    """All that defines a run's numbers besides its method and seed."""
    task = {} if options.env == WALKER else {"task": facts(options.env)}
    return task | {
        "backend": options.backend,
        "episodes": options.scale().episodes,
        "test_episodes": options.scale().test_episodes,
        "alarm_window": ALARM_WINDOW,
        "human_policy": policy_digest(options.human_policy),
        "agent": dataclasses.asdict(options.agent),
        "loop": dataclasses.asdict(options.loop),
        "hyper": dataclasses.asdict(options.hyper),
    }


class Sweep:
    """The runs that are left to do, with all that happens around them.

    Args:
        prepared: the sweep.
        display: what a person sees of it.
    """

    def __init__(self, prepared: Prepared, display: Display):
        options, agent, self._folder, self._config = prepared
        self._options = options
        finished = self._folder.finished()
        specs = [spec for spec in options.specs() if spec.key not in finished]
        assert options.backend is not None
        episodes = options.scale().test_episodes
        walkers = Walkers(options.backend, options.slots, options.workers, episodes, options.env)
        self._batch = Batch("under_way", agent, specs, options.loop, walkers)
        self._running: Sequence[Run] = []
        self._drawing = BackgroundFigures(self._folder.path, self._save_partial)
        self._display = display
        self._logs = SweepLogs(options.log, self._folder.path, self._config, display.say)

    def run(self) -> list[Any]:
        """Makes the runs that the folder lacks, and draws.

        Returns:
            The paths of tables and figures, and notes on what could not be drawn.

        Raises:
            Interrupted: after Ctrl-C or SIGTERM; what there is is saved and drawn.
            LaunchError: if other machines failed; what there is is drawn.
            ResultsError: if the disk refuses.
        """
        launcher = self._options.launch.make(
            self._folder.path, self._options.save_seconds, self._folder.finished, self._display.say
        )
        try:
            self._make(launcher)
        except Interrupted:
            self._save_partial()
            draw(self._folder)
            raise
        except LaunchError:
            draw(self._folder)
            raise
        except ResultsError as error:
            if not self._running:
                raise  # Nothing has begun; what the error says is what is to be done.
            raise ResultsError(
                f"{error}. What was finished or saved before is kept; the same command goes on"
            ) from error
        return draw(self._folder)

    def _make(self, launcher: Launcher) -> None:
        """Trains, tests and writes every run."""
        if self._batch.specs:
            self._display.say(f"results: {self._options.out}")
        try:
            with (
                self._display if self._batch.specs else contextlib.nullcontext(),
                contextlib.closing(launcher.make([self._batch], self._show)) as made,
            ):
                for tested in made:
                    self._finish(tested)
        finally:
            self._drawing.stop()
            self._logs.close()

    def _show(self, running: Sequence[Run]) -> None:
        self._running = running
        self._display.show(running)
        self._logs.follow(running)
        self._drawing.draw_if_due()

    def _save_partial(self) -> None:
        """Writes, for the figures, the episodes of the runs that are not finished."""
        finished = self._folder.finished()
        for run in self._running:
            key = run.spec.key
            if run.episodes and key not in finished:
                self._folder.write_partial(key, to_columns(run.episodes, EPISODE_COLUMNS))

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
            checkpoint.flatten(tested.finished.kept, tested.finished.boundary),
            info,
            to_columns(tested.progress, PROGRESS_COLUMNS),
            run.recordings,
            run.diagnostics,
        )
        self._folder.remove_partial(key)
        self._logs.finish(run, tested.tests, tested.progress)
        self._display.finish(run)
        alone = [row["return"] for row in tested.tests if row["mode"] == "autonomous"]
        self._display.say(
            f"finished {key.method} seed {key.seed}: {run.env_steps:,} steps, "
            f"test return {np.mean(alone):.1f} over {len(alone)} episodes"
            + (f"; diverged: {run.diverged}" if run.diverged else "")
            + (f"; {LOST_TESTS}: {info['lost_tests']}" if info["lost_tests"] else "")
        )
