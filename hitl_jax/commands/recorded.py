"""What a person did in a live session, as a human for sweeps: `hitl-jax recorded`.

    hitl-jax recorded runs/live/session.jsonl
    hitl-jax sweep --human recorded:runs/live/session.jsonl.human.npz

Plays the session again, writes the person's judgements step by step, and says which simulated human
they are most like.
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.analysis.markdown import table
from hitl_jax.console.cli import checking_input
from hitl_jax.console.output import say
from hitl_jax.errors import ResultsError
from hitl_jax.live import journal
from hitl_jax.live.begin import differences
from hitl_jax.live.recorded_person import Steps, fits_of, setup_again, steps_of
from hitl_jax.live.session import Session
from hitl_jax.sweep import recorded_human
from hitl_jax.sweep.compile_cache import keep_programs


@dataclasses.dataclass(frozen=True)
class RecordedOptions:
    """Make a human for sweeps of what a person did in a live session.

    Attributes:
        journal: of the session.
        start: the `params.npz` that it began with, if it began with one.
        human_policy: the `params.npz` of its assistant, if it had one.
    """

    journal: tyro.conf.Positional[str]
    start: str | None = None
    human_policy: str | None = None


def main(options: RecordedOptions) -> int:
    """Plays the session again, writes the judgements, and compares.

    Args:
        options: which.

    Returns:
        The exit code.
    """
    path = pathlib.Path(options.journal)
    with checking_input(results="JOURNAL"):
        header, lines = journal.read(path)
        setup = setup_again(path, header, options.start, options.human_policy)
    if line := differences(path, header):
        say(line)
    keep_programs()
    steps = steps_of(Session(setup), lines, path)
    if not len(steps.dangerous):
        raise ResultsError(f"{path}: no step was played that a person judged")
    out = path.with_name(f"{path.name}.human.npz")
    recorded_human.write(out, steps.dangerous)
    print("\n".join(report_of(steps)))
    print(f"\nThe person as a human for sweeps: --human {recorded_human.PREFIX}{out}")
    return 0


def report_of(steps: Steps) -> list[str]:
    """Lines of text that compare the person with simulated humans."""
    dangerous, alarmed = steps.dangerous, steps.alarmed
    lines = [
        f"{len(dangerous):,} steps of {steps.episodes} episodes; "
        f"judged dangerous: {int(dangerous.sum()):,} steps ({dangerous.mean():.1%})",
        f"steps with an alarm: {int(alarmed.sum()):,}, of which the person agreed with "
        f"{int((alarmed & dangerous).sum()):,}",
    ]
    if steps.unjudged:
        lines.append(f"steps that nobody was there to judge, left out: {steps.unjudged:,}")
    if not dangerous.any():
        return [*lines, "Nothing was judged dangerous: there is nothing to compare."]
    cells = [
        ["simulated human", "tolerance [rad]", "delay [steps]", "misses", "fears", "disagrees"]
    ]
    fits = fits_of(steps)
    for name, fit in fits.items():
        shares = [f"{fit.missed:.1%}", f"{fit.feared:.1%}", f"{fit.disagrees:.2%}"]
        cells.append([name, f"{fit.tolerance:.3f}", str(fit.delay), *shares])
    best = min(fits, key=lambda name: fits[name].disagrees)
    fit = fits[best]
    nearest = (
        f"Nearest: --danger {best} --human.tolerance {fit.tolerance:.3f} --human.delay {fit.delay} "
        f"--human.mistake-rate {fit.disagrees:.4f}"
    )
    return [*lines, "", table(cells), nearest]
