"""An ablation's runs: which there are, which are missing, and how those are made."""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from hitl_jax.analysis.claims_over_steps import area_of
from hitl_jax.analysis.summary import summarise_run
from hitl_jax.analysis.task_facts import STEPS_PER_SECOND
from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.envs import host_backend, require_backend
from hitl_jax.evaluation.trials import milestones
from hitl_jax.results.episode_tables import (
    EPISODE_COLUMNS,
    PROGRESS_COLUMNS,
    TEST_COLUMNS,
    to_columns,
    to_table,
)
from hitl_jax.results.folder import Run
from hitl_jax.results.provenance import short_commit
from hitl_jax.studies.ablations.late_training import late_training
from hitl_jax.studies.ablations.settings import Ablation, Setting
from hitl_jax.studies.ablations.store import AREA, FALLS, Row, RunId, Store, digest
from hitl_jax.sweep.autosave import SAVE_SECONDS
from hitl_jax.sweep.changes import Parts, changed, changes_of_task
from hitl_jax.sweep.launchers import LaunchOptions
from hitl_jax.sweep.run_sweep import Display
from hitl_jax.sweep.train_and_test import Batch, Tested, Walkers, make_team
from hitl_jax.tasks import task_of
from hitl_jax.training.run_spec import RunSpec

_SLOTS = 32


class Group(NamedTuple):
    """Runs that one compiled program can train.

    Attributes:
        name: of the group among others; its saves are kept by it.
        parts: the options of one of them.
        ablation: one that they are of; task and budget, but for the seeds, are those of all.
        missing: those that the store lacks, with their options.
    """

    name: str
    parts: Parts
    ablation: Ablation
    missing: dict[RunId, Parts]


def missing_runs(ablations: Iterable[Ablation], store: Store) -> list[Group]:
    """The runs of some ablations that the store lacks, by the program that trains them.

    Args:
        ablations: with the budgets that are asked for.
        store: the runs that are done.

    Returns:
        The groups, the largest first; one without missing runs is among them.

    Raises:
        ImportError: one line, if there are such runs and no walkers to make them with.
        ValueError: one line, if a setting is not allowed, or a task cannot be had.
    """
    groups: dict[str, Group] = {}
    for ablation in ablations:
        for setting, parts in settings_of(ablation):
            program = digest(parts._replace(hyper=Hyper()), ablation.of_a_run)
            group = groups.setdefault(program, Group(f"under_way-{program}", parts, ablation, {}))
            ids = runs_of(ablation, setting, parts)
            group.missing.update({run: parts for run in ids if run not in store})
    for group in groups.values():
        if group.missing:
            played = task_of(group.ablation.env).env_id
            require_backend(host_backend(played), played)
    return sorted(groups.values(), key=lambda group: len(group.missing), reverse=True)


def make_runs(
    groups: Sequence[Group], launch: LaunchOptions, store: Store, display: Display
) -> None:
    """Trains and tests runs, those of one compiled program together, and adds them to the store.

    Args:
        groups: of `missing_runs`.
        launch: where runs are made.
        store: each run is written as it ends.
        display: what a person sees.

    Raises:
        Interrupted: after Ctrl-C or SIGTERM; finished runs are in the store.
        ResultsError: if the disk refuses.
    """
    missing = {run.key: run for group in groups for run in group.missing}
    rates = {
        run.key: task_of(group.ablation.env).steps_per_second
        for group in groups
        for run in group.missing
    }
    batches = [batch_of(group) for group in groups]
    launcher = launch.make(store.path.parent, SAVE_SECONDS, store.keys, display.say)
    with display, contextlib.closing(launcher.make(batches, display.show)) as made:
        for tested in made:
            run = missing[tested.key]
            row = summary_of(tested, rates[tested.key])
            store.add(run, row | {"commit": short_commit(tested.commit)})
            display.finish(tested.finished.run)
            display.say(
                f"finished {run.setting or 'base'}, {run.method} seed {run.seed}: "
                f"test {row['test_return_mean']:.1f}"
            )


def batch_of(group: Group) -> Batch:
    """Runs of one compiled program, seed after seed: early tables are fair."""
    budget, env = group.ablation.budget, group.ablation.env
    specs = [
        RunSpec(
            Method(run.method),
            run.seed,
            hyper_for(Method(run.method), parts.hyper),
            budget.episodes,
            milestones(budget.episodes),
            setting=run.digest,
        )
        for run, parts in sorted(group.missing.items(), key=lambda item: item[0].seed)
    ]
    agent = make_team(group.parts.agent, group.parts.human_policy)
    backend = host_backend(task_of(env).env_id)
    walkers = Walkers(backend, _SLOTS, None, budget.test_episodes, env)
    return Batch(group.name, agent, specs, group.parts.loop, walkers)


def settings_of(ablation: Ablation) -> Iterator[tuple[Setting, Parts]]:
    """Its settings, each with the options that it stands for."""
    task = changes_of_task(ablation.env)
    for setting in ablation.settings:
        yield setting, changed(ablation.base | task | setting.changes)


def runs_of(ablation: Ablation, setting: Setting, parts: Parts) -> list[RunId]:
    """The runs of a setting: of each method all seeds."""
    mark, seeds = digest(parts, ablation.of_a_run), ablation.budget.all_seeds
    return [RunId(setting.name, m, seed, mark) for m in setting.methods for seed in seeds]


def summary_of(tested: Tested, steps_per_second: float = STEPS_PER_SECOND) -> Row:
    """What the store keeps of a run.

    Args:
        tested: the run.
        steps_per_second: of the task's time.
    """
    run = tested.finished.run
    episodes = to_table(to_columns(run.all_episodes(), EPISODE_COLUMNS), EPISODE_COLUMNS)
    tests = to_table(to_columns(tested.tests, TEST_COLUMNS), TEST_COLUMNS)
    task = {"task": {"steps_per_second": steps_per_second}}
    info = {"wall_seconds": tested.wall_seconds, "diverged": run.diverged, "config": task}
    progress = to_table(to_columns(tested.progress, PROGRESS_COLUMNS), PROGRESS_COLUMNS)
    trained = Run(run.spec.key, info, episodes, tests, progress)
    row = summarise_run(trained) | late_training(trained, run.spec.hyper.unattended_every)
    row |= {AREA: area_of(trained, milestones(run.spec.episodes))}
    row |= {FALLS: int(episodes["fall"].sum())}
    return {name: value for name, value in row.items() if name not in ("method", "seed")}
