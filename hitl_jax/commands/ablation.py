"""One part of the team taken apart: `hitl-jax ablation NAME`.

Settings and seeds are trained side by side, tested, and compared in a table and a figure. What is
done is kept, and not done again when the command is given again or when another ablation has the
same setting.
"""

import contextlib
import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np
import tyro

from hitl_jax.analysis import stats
from hitl_jax.analysis.figure_style import attempt, save
from hitl_jax.analysis.summary import summarise_run
from hitl_jax.choices.checks import require_seeds, require_whole
from hitl_jax.config import Hyper, Method, hyper_for
from hitl_jax.console.cli import checking_input
from hitl_jax.console.progress import Progress
from hitl_jax.envs import require_backend
from hitl_jax.errors import BadInput, ResultsError
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES
from hitl_jax.results.atomic_files import locked, write_text_atomic
from hitl_jax.results.episode_tables import EPISODE_COLUMNS, TEST_COLUMNS, to_columns, to_table
from hitl_jax.results.folder import Run
from hitl_jax.results.provenance import short_commit
from hitl_jax.studies.ablations import figure
from hitl_jax.studies.ablations.settings import ABLATIONS, Ablation, Setting
from hitl_jax.studies.ablations.store import Row, RunId, Store, digest
from hitl_jax.studies.ablations.table import Line, to_markdown
from hitl_jax.studies.changes import Parts, changed
from hitl_jax.sweep.autosave import SAVE_SECONDS
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.sweep.launchers import LaunchOptions
from hitl_jax.sweep.signals import Interrupted
from hitl_jax.sweep.train_and_test import Batch, Plant, Tested, make_team
from hitl_jax.training.run_spec import RunSpec

_SLOTS = 32
_BACKEND = "lean"


@dataclasses.dataclass(frozen=True)
class AblationOptions:
    """Compare settings of one part of the team, each over several seeds.

    Attributes:
        name: one of methods, exploration, intervention, feedback, source, delta, initial-boundary,
            indicator, human-tolerance, human-delay, human-mistakes, human-attention, arbiter; or
            `all`.
        seeds: number of seeds for each setting.
        first_seed: the first of them.
        episodes: training episodes of a run.
        test_episodes: test episodes of a run, alone and again with the human.
        out: folder of the results: `runs.csv`, and a table and a figure for each ablation. An
            interrupted ablation goes on in the same folder where it was.
        launch: where runs are made.
    """

    name: tyro.conf.Positional[str]
    seeds: int = 5
    first_seed: int = 0
    episodes: int = 300
    test_episodes: int = 20
    out: str = "runs/ablations"
    launch: Annotated[LaunchOptions, tyro.conf.arg(name="")] = LaunchOptions()

    @property
    def budget(self) -> dict[str, int]:
        """What must be equal for two runs to be compared."""
        return {"episodes": self.episodes, "test_episodes": self.test_episodes}


def main(options: AblationOptions) -> int:
    """Runs what is not done yet, then prints the tables.

    Args:
        options: what to run.

    Returns:
        The exit code: 0, 130 after Ctrl-C, or 143 after SIGTERM.
    """
    out = pathlib.Path(options.out)
    with contextlib.ExitStack() as held:
        with checking_input():
            names = _names(options)
            held.enter_context(options.launch.checked().ready())
            try:
                held.enter_context(locked(out))
                store = Store(out / "runs.csv")
                store.write()  # A folder that cannot be written is noticed now.
            except ResultsError as error:
                raise BadInput(f"--out {error}") from error
        return _make_runs(names, options, store)


def _make_runs(names: list[str], options: AblationOptions, store: Store) -> int:
    """Makes the runs that the store lacks, and draws; the exit code."""
    keep_programs()
    code = 0
    try:
        _run(names, options, store)
    except Interrupted as stop:
        print(
            f"\nStopped. Finished runs are in {store.path}. {options.launch.goes_on}",
            flush=True,
        )
        code = stop.exit_code
    for name in names:
        if text := write_ablation(name, options, store):
            print(text)
    return code


def _names(options: AblationOptions) -> list[str]:
    """The ablations that are asked for; ValueError with one line for options that cannot be run."""
    if options.name != "all" and options.name not in ABLATIONS:
        raise ValueError(f"NAME {options.name}: must be one of {', '.join(ABLATIONS)}, all")
    require_seeds(options.first_seed, options.seeds)
    require_whole("episodes", options.episodes, at_least=1)
    require_whole("test_episodes", options.test_episodes, 1, MOST_TEST_EPISODES)
    return list(ABLATIONS) if options.name == "all" else [options.name]


class _Group(NamedTuple):
    """Runs that one compiled program can train.

    Attributes:
        parts: of one of them.
        missing: those that the store lacks.
    """

    parts: Parts
    missing: dict[RunId, Parts]


def _run(names: list[str], options: AblationOptions, store: Store) -> None:
    """Trains and tests the runs that the store lacks; those of one compiled program together."""
    groups: dict[str, _Group] = {}
    for name in names:
        for setting, parts in _parts(ABLATIONS[name]):
            program = digest(parts._replace(hyper=Hyper()), {})
            group = groups.setdefault(program, _Group(parts, {}))
            ids = _ids(setting, parts, options)
            group.missing.update({run: parts for run in ids if run not in store})
    missing = {run.key: run for group in groups.values() for run in group.missing}
    if missing:
        with checking_input():
            require_backend(_BACKEND)
    methods = [m for m in Method if any(run.method == m for run in missing.values())]
    largest_first = sorted(groups.items(), key=lambda one: len(one[1].missing), reverse=True)
    batches = [_batch(f"under_way-{name}", group, options) for name, group in largest_first]
    progress = Progress(methods, len(missing), options.episodes, 0)
    launcher = options.launch.make(store.path.parent, SAVE_SECONDS, store.keys, progress.say)
    with progress, contextlib.closing(launcher.make(batches, progress.show)) as made:
        for tested in made:
            run = missing[tested.key]
            row = _summary(tested)
            store.add(run, row | {"commit": short_commit(tested.commit)})
            progress.finish(tested.finished.run)
            alone = row["test_return_mean"]
            progress.say(
                f"finished {run.setting or 'defaults'}, {run.method} seed {run.seed}: "
                f"test {alone:.1f}"
            )


def _batch(name: str, group: _Group, options: AblationOptions) -> Batch:
    """Runs of one compiled program, seed after seed: early tables are fair."""
    specs = [
        RunSpec(
            Method(run.method),
            run.seed,
            hyper_for(Method(run.method), parts.hyper),
            options.episodes,
            setting=run.digest,
        )
        for run, parts in sorted(group.missing.items(), key=lambda item: item[0].seed)
    ]
    agent = make_team(group.parts.agent, group.parts.human_policy)
    plant = Plant(_BACKEND, _SLOTS, None, options.test_episodes)
    return Batch(name, agent, specs, group.parts.loop, plant)


def _parts(ablation: Ablation) -> Iterator[tuple[Setting, Parts]]:
    for setting in ablation.settings:
        yield setting, changed(setting.changes)


def _ids(setting: Setting, parts: Parts, options: AblationOptions) -> list[RunId]:
    mark = digest(parts, options.budget)
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    return [RunId(setting.name, m, seed, mark) for m in setting.methods for seed in seeds]


def _summary(tested: Tested) -> Row:
    run = tested.finished.run
    episodes = to_table(to_columns(run.all_episodes(), EPISODE_COLUMNS), EPISODE_COLUMNS)
    tests = to_table(to_columns(tested.tests, TEST_COLUMNS), TEST_COLUMNS)
    info = {"wall_seconds": tested.wall_seconds, "diverged": run.diverged}
    row = summarise_run(Run(run.spec.key, info, episodes, tests))
    return {name: value for name, value in row.items() if name not in ("method", "seed")}


def lines_of(name: str, options: AblationOptions, store: Store) -> list[Line]:
    """What is done of an ablation.

    Args:
        name: one of `ABLATIONS`.
        options: seeds and budget.
        store: the runs.

    Returns:
        A line for each setting and method that has a run.
    """
    lines = []
    for setting, parts in _parts(ABLATIONS[name]):
        done = [run for run in _ids(setting, parts, options) if run in store]
        for method in setting.methods:
            if runs := [store[run] for run in done if run.method == method]:
                lines.append(Line(setting.label, method, runs))
    return lines


def write_ablation(name: str, options: AblationOptions, store: Store) -> str:
    """Writes table and figure of what is done of an ablation.

    Args:
        name: one of `ABLATIONS`.
        options: seeds and budget.
        store: the runs; the files go beside it.

    Returns:
        The table, empty without a run.

    Raises:
        ResultsError: if a file cannot be written.
    """
    lines = lines_of(name, options, store)
    if not lines:
        return ""
    last = options.first_seed + options.seeds - 1
    budget = (
        f"Seeds {options.first_seed} to {last}, {options.episodes} training episodes, "
        f"{options.test_episodes} test episodes each way."
    )
    done = sum(len(line.runs) for line in lines)
    asked = options.seeds * sum(len(setting.methods) for setting in ABLATIONS[name].settings)
    if done < asked:
        budget += (
            f"\n\n**Under way**: {done} of {asked} runs; those that end first are no fair choice."
        )
    rng = np.random.default_rng(stats.SEED)
    ablation = ABLATIONS[name]
    text = to_markdown(ablation.title, budget, lines, rng)
    write_text_atomic(store.path.parent / f"{name}.md", text)
    draw = figure.draw_curves if ablation.is_number else figure.draw_rows

    def make() -> list[pathlib.Path]:
        return save(draw(ablation.title, lines, rng), store.path.parent / name)

    for failure in attempt({name: make}).failures:
        print(failure)
    return text
