"""The main job: `python -m experiments.seed_sweep`.

Trains SRL, HITL-FIX and HITL-AC over a batch of seeds on Box2D's BipedalWalker-v3, tests each
trained walker, and writes tables and Figures 4 to 6. Started again in the same folder it goes on
where it was.
"""

import contextlib
import dataclasses
import os
import shlex
import subprocess
import sys
import time
from typing import Any

import numpy as np

from experiments import judgements
from experiments.cli import BadInput, checking_input, run_main
from experiments.compile_cache import keep_programs
from experiments.options import SweepOptions
from experiments.progress import Progress
from experiments.signals import Interrupted
from experiments.training import Plant, Tested, make_team, policy_digest, train_and_test
from experiments.under_way import UnderWay
from hitl_jax import checkpoint, figures, stats
from hitl_jax.agent import Agent
from hitl_jax.config import Method, hyper_for
from hitl_jax.devices import learning_devices
from hitl_jax.envs import make_pool, num_cores
from hitl_jax.episodes import ALARM_WINDOW
from hitl_jax.evaluation import milestones
from hitl_jax.files import ResultsError, locked
from hitl_jax.human import recorded
from hitl_jax.provenance import processor, versions
from hitl_jax.results import ResultsFolder
from hitl_jax.rollout import Rollout
from hitl_jax.runs import RunSpec, num_slots
from hitl_jax.summary import write_summary
from hitl_jax.tables import EPISODE_COLUMNS, PROGRESS_COLUMNS, TEST_COLUMNS, to_columns

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
            options = options.checked()
            dangerous = judgements.load(options.human)
            judge = None if dangerous is None else recorded(dangerous)
            agent = make_team(options.agent, options.human_policy, judge)
            folder = ResultsFolder(options.out)
            config = _config(options) | judgements.digest(dangerous)
            if options.backend == "envpool":
                make_pool(
                    "envpool", 1
                ).close()  # a missing extra is noticed before a folder is made
            command = shlex.join(["python", "-m", "experiments.seed_sweep", *sys.argv[1:]])
            try:
                held.enter_context(locked(folder.path))
                changed = folder.create_or_resume(config, command)
                judgements.keep(folder.path, dangerous)
            except ResultsError as error:
                raise BadInput(f"--out {error}") from error
        if changed:
            print(f"{options.out} was begun with other code: {', '.join(changed)}", flush=True)
        return _make_runs(options, agent, folder, config)


def _make_runs(
    options: SweepOptions, agent: Agent, folder: ResultsFolder, config: dict[str, Any]
) -> int:
    """Makes the runs that the folder lacks, and draws; the exit code."""
    scale = options.scale()
    seeds = range(options.first_seed, options.first_seed + scale.seeds)
    wanted = [
        RunSpec(
            method,
            seed,
            hyper_for(method, options.hyper),
            scale.episodes,
            milestones(scale.episodes),
        )
        for seed in seeds
        for method in map(Method, options.methods)
    ]
    finished = folder.finished()
    specs = [spec for spec in wanted if spec.key not in finished]
    keep_programs()
    sweep = _Sweep(options, agent, folder, config, len(wanted), specs)
    try:
        sweep.run()
    except Interrupted as stop:
        sweep.under_way.save()
        sweep.save_partial()
        _draw(folder)
        print(
            f"\nStopped. Figures and tables of what there is: {options.out}. The same command goes "
            "on where it was.",
            flush=True,
        )
        return stop.exit_code
    except ResultsError as error:
        if not sweep.under_way.runs():
            raise  # Nothing has begun; what the error says is what is to be done.
        raise ResultsError(
            f"{error}. What was finished or saved before is kept; the same command goes on"
        ) from error
    for line in _draw(folder):
        print(line)
    return 0


class _Sweep:
    """The runs that are left to do, with all that happens around them."""

    def __init__(
        self,
        options: SweepOptions,
        agent: Agent,
        folder: ResultsFolder,
        config: dict[str, Any],
        num_runs: int,
        specs: list[RunSpec],
    ):
        self._options = options
        self._agent = agent
        self._folder = folder
        self._config = config
        self._specs = specs
        self.under_way = UnderWay(
            folder.path / "under_way", options.loop.frames, options.save_seconds
        )
        self._drawing: subprocess.Popen | None = None
        self._started = time.monotonic()
        self._draw_at = self._started + FIRST_FIGURES_SECONDS
        self._provenance = {
            "versions": versions(),
            "machine": f"{processor()}, {num_cores()} cores",
        }
        self._progress = Progress(
            options.methods, num_runs, options.scale().episodes, num_runs - len(specs)
        )

    def run(self) -> None:
        """Trains, tests and writes every run."""
        if self._specs:
            try:
                self._run()
            finally:
                self._stop_drawing()
            return
        self.under_way.tidy(self._folder.finished(), self._progress.say)

    def _run(self) -> None:
        options = self._options
        devices = learning_devices()
        slots = num_slots(len(self._specs), options.slots)
        plant = Plant(options.backend, slots, options.workers, options.scale().test_episodes)
        with self._progress as progress:
            progress.say(
                f"{len(self._specs)} runs in {slots} slots on {len(devices)} {devices[0].platform} "
                f"devices; results in {options.out}"
            )
            asked = {spec.key for spec in self._specs}
            going_on = self.under_way.take(asked, self._folder.finished(), progress.say)
            tested = train_and_test(
                self._agent, self._specs, options.loop, plant, self._watch, going_on
            )
            with contextlib.closing(tested):
                for run in tested:
                    self._finish(run)
        self.under_way.end()

    def _watch(self, rollout: Rollout) -> None:
        self._progress.show(rollout.runs())
        self.under_way.watch(rollout)
        self._draw_now_and_then()

    def save_partial(self) -> None:
        """Writes, for the figures, the episodes of the runs that are not finished."""
        for run in self.under_way.runs():
            key = run.spec.key
            if run.episodes and key not in self._folder.finished():
                self._folder.write_partial(key, to_columns(run.episodes, EPISODE_COLUMNS))

    def _stop_drawing(self) -> None:
        """Ends a drawing that is under way: a folder has one writer."""
        if self._drawing is not None:
            self._drawing.terminate()
            self._drawing.wait()

    def _finish(self, tested: Tested) -> None:
        """Writes a trained and tested run."""
        finished, tests, progress = tested
        run = finished.run
        spec = run.spec
        info = {
            "config": self._config,
            "wall_seconds": time.monotonic() - run.started,
            "env_steps": run.env_steps,
            "updates": run.updates,
            "diverged": run.diverged and run.diverged._asdict(),
            "commit": self.under_way.commit_of(spec.key),
            **self._provenance,
        }
        key = spec.key
        arrays = checkpoint.flatten(finished.train, finished.boundary)
        self._folder.save_run(
            key,
            to_columns(run.all_episodes(), EPISODE_COLUMNS),
            to_columns(tests, TEST_COLUMNS),
            arrays,
            info,
            to_columns(progress, PROGRESS_COLUMNS),
            run.recordings,
        )
        self._folder.remove_partial(key)
        self._progress.finish(run)
        alone = [row["return"] for row in tests if row["mode"] == "autonomous"]
        self._progress.say(
            f"finished {spec.method} seed {spec.seed}: {run.env_steps:,} steps, "
            f"test return {np.mean(alone):.1f} over {len(alone)} episodes"
            + (f"; diverged: {run.diverged}" if run.diverged else "")
        )

    def _draw_now_and_then(self) -> None:
        """Draws in another process, of lower priority, so that training does not wait."""
        if time.monotonic() < self._draw_at or (self._drawing and self._drawing.poll() is None):
            return
        self.save_partial()
        command = [sys.executable, "-m", "experiments.figures", self._options.out]
        self._drawing = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
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


def _draw(folder: ResultsFolder) -> list[Any]:
    """Writes summary and figures; the paths written, and notes on what could not be drawn."""
    tables = write_summary(folder, np.random.default_rng(stats.SEED))
    paths, notes = figures.draw_all(folder, np.random.default_rng(stats.SEED))
    return [*tables, *paths, *notes]


if __name__ == "__main__":
    sys.exit(run_main(SweepOptions, main))
