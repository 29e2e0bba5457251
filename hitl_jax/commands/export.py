"""What walkers and people did, for other libraries: `hitl-jax export`.

    hitl-jax export results/full --phase assisted --id walker/assisted-v0
    hitl-jax export runs/live/session.jsonl --id walker/me-v0

Writes a Minari dataset: observations, actions, rewards and ends, and of each step who acted,
whether the human judged it dangerous, the boundary and the alarm.
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.choices.checks import one_of
from hitl_jax.config import Method
from hitl_jax.console.cli import checking_input, refusing
from hitl_jax.errors import InvalidValue
from hitl_jax.exchange import minari_files
from hitl_jax.exchange.of_journal import of_journal
from hitl_jax.exchange.played import of_results
from hitl_jax.playback.replay import Phase
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep.compile_cache import keep_programs


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """Write episodes as a Minari dataset.

    Attributes:
        source: a folder that a sweep has written, or the journal of a live session.
        id: name of the dataset, as walker/session-v0.
        phase: of a folder: recorded `training` episodes (two of each run), or those of the
            `autonomous` or `assisted` test.
        methods: of a folder: whose runs.
        start: of a journal: the `params.npz` that the session began with, if it began with one.
        human_policy: the file given under this name, if there was one.
        out: folder of Minari's datasets; `MINARI_DATASETS_PATH` names it to Minari.
    """

    source: tyro.conf.Positional[pathlib.Path]
    id: str
    phase: Phase = "training"
    methods: tuple[str, ...] = tuple(Method)
    start: str | None = None
    human_policy: str | None = None
    out: pathlib.Path = pathlib.Path("runs/minari")


def main(options: ExportOptions) -> int:
    """Plays the episodes again, and writes them.

    Args:
        options: which.

    Returns:
        The exit code.
    """
    with checking_input():
        minari_files.require_id(options.id)
        for method in options.methods:
            one_of("methods", method, tuple(Method))
        if options.source.is_dir():
            if options.start is not None:
                raise InvalidValue("start", options.start, "is of a journal, not of a folder")
            folder = ResultsFolder(options.source)
            source = of_results(folder, options.phase, options.methods, options.human_policy)
        else:
            source = of_journal(options.source, options.start, options.human_policy)
    keep_programs()
    with refusing():
        episodes, steps = minari_files.write(options.out, options.id, source)
    print(f"{options.out / options.id}: {episodes} episodes, {steps:,} steps")
    print(f'MINARI_DATASETS_PATH={options.out}: minari.load_dataset("{options.id}")')
    return 0
