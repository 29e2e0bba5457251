"""One table of the live sessions of several people, beside simulated humans.

    hitl-jax live --guided --journal runs/people/anna.jsonl
    hitl-jax live --guided --journal runs/people/ben.jsonl
    hitl-jax participants runs/people

Plays each session again, and the same session with each simulated human; writes
`participants.csv` and `participants.md` into the folder.
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.console.cli import checking_input, refusing
from hitl_jax.console.output import say
from hitl_jax.errors import InvalidValue
from hitl_jax.live import participants
from hitl_jax.results.atomic_files import write_text_atomic
from hitl_jax.results.episode_tables import table_to_csv
from hitl_jax.sweep.compile_cache import keep_programs


@dataclasses.dataclass(frozen=True)
class ParticipantsOptions:
    """Make one table of the live sessions of several people.

    Attributes:
        folder: has their journals, `*.jsonl`; all began with the same options.
        start: the `params.npz` that the sessions began with, if they began with one.
        human_policy: the `params.npz` of their assistant, if they had one.
    """

    folder: tyro.conf.Positional[pathlib.Path]
    start: str | None = None
    human_policy: str | None = None


def main(options: ParticipantsOptions) -> int:
    """Plays the sessions again, and writes the table.

    Args:
        options: which.

    Returns:
        The exit code.
    """
    folder = options.folder
    with checking_input(results="FOLDER"):
        if not folder.is_dir():
            raise InvalidValue("folder", str(folder), "must be a folder of journals")
        study = participants.read(folder, options.start, options.human_policy, say)
    keep_programs()
    found = []
    for one in participants.all_of(study):
        say(f"played {one.name}: {one.minutes:.1f} minutes")
        found.append(one)
    report = participants.report(found)
    with refusing(results="FOLDER"):
        write_text_atomic(folder / "participants.csv", table_to_csv(participants.csv_table(found)))
        write_text_atomic(folder / "participants.md", report)
    print(report, end="")
    return 0
