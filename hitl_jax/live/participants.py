"""A study of several people: each session as a line of numbers, beside simulated humans.

All sessions must have begun alike. A simulated human plays the same session, as long as the longest
of them.
"""

import dataclasses
import pathlib
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hitl_jax.analysis.markdown import table
from hitl_jax.errors import ResultsError
from hitl_jax.evaluation.trials import frozen
from hitl_jax.live import journal
from hitl_jax.live.begin import first_difference, setup_of
from hitl_jax.live.guide import SCALES, agreed, was_played
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.pacing import RATE
from hitl_jax.live.recorded_person import (
    Steps,
    fits_of,
    options_again,
    simulated_steps,
    steps_of,
)
from hitl_jax.live.session import Session
from hitl_jax.live.setup import SessionSetup
from hitl_jax.results.episode_tables import Table
from hitl_jax.sweep.presets import HUMAN_PRESETS

_SIMULATED = ("ideal", "person")
_NAN = float("nan")


class Participant(NamedTuple):
    """A human in numbers; NaN where there is none.

    Attributes:
        name: of the journal, without its ending; or of the preset of a simulated human.
        minutes: played, in real time [min].
        episodes: that ended.
        falls: of these.
        mean_return: of these.
        dangerous: share of the judged steps that were judged dangerous.
        alarms: steps with an alarm, of those that were judged.
        agreed: share of these that were judged dangerous.
        human_seconds: in which the human's actions were executed [s].
        tolerance: angle from which the most similar `threshold` human sees danger [rad].
        delay: its reaction delay [steps].
        disagrees: share of the steps on which the two disagree.
        workload: mean of the answers.
        answers: to `guide.SCALES`, 0 to 100.
    """

    name: str
    minutes: float
    episodes: int
    falls: int
    mean_return: float
    dangerous: float
    alarms: int
    agreed: float
    human_seconds: float
    tolerance: float
    delay: float
    disagrees: float
    workload: float
    answers: tuple[float, ...]


class Study(NamedTuple):
    """The sessions of a folder.

    Attributes:
        paths: of the journals.
        options: with which they began.
        lines: of each journal.
    """

    paths: list[pathlib.Path]
    options: LiveOptions
    lines: list[list[journal.Line]]


def read(
    folder: pathlib.Path, start: str | None, human_policy: str | None, say: Callable[[str], None]
) -> Study:
    """Reads all journals of a folder.

    Args:
        folder: has the journals, `*.jsonl`.
        start: the `params.npz` that the sessions began with, if they began with one.
        human_policy: the `params.npz` of the assistant, if there was one.
        say: is told which were left out.

    Raises:
        ResultsError: one line, if there is none, one is damaged, or two did not begin alike.
        ValueError: one line, if the files are others.
    """
    found = {}
    for path in sorted(folder.glob("*.jsonl")):
        begun = journal.read(path) if path.stat().st_size else ({}, [])
        if was_played(begun[1]):
            found[path] = begun
        else:
            say(f"{path}: nothing was played; it is left out")
    if not found:
        raise ResultsError(f"{folder}: has no journal of a session that was played (*.jsonl)")
    paths, read = list(found), list(found.values())
    first, _ = read[0]
    for path, (header, lines) in zip(paths, read, strict=True):
        if differs := first_difference(_begun(*read[0]), _begun(header, lines)):
            name, has, other = differs
            raise ResultsError(
                f"{path}: its session has {name} {other}, that of {paths[0].name} {has}: "
                "sessions that are compared must begin alike"
            )
    return Study(
        paths, options_again(paths[0], first, start, human_policy), [lines for _, lines in read]
    )


def _begun(header: journal.Line, lines: list[journal.Line]) -> journal.Line:
    """How a session began, and was guided."""
    guide = agreed(lines) or {}
    told = {name: guide.get(name) for name in ("steps", "asks", "answer_seconds")}
    return header | {"guide": told}


def all_of(study: Study) -> Iterator[Participant]:
    """Plays all sessions again, and then those of the simulated humans.

    Raises:
        ResultsError: if a session does not come out as it was noted.
    """
    longest, setup = 0, setup_of(study.options)
    for path, lines in zip(study.paths, study.lines, strict=True):
        session = Session(setup)
        steps = steps_of(session, lines, path)
        longest = max(longest, session.env_steps)
        said = [line["said"] for line in lines if "said" in line]
        answers = [one["answers"] for one in said if one["type"] == "questionnaire"]
        yield _told(path.name.removesuffix(".jsonl"), session, steps, *answers[-1:])
    for name in _SIMULATED:
        session = Session(_simulated(study.options, name))
        yield _told(f"simulated: {name}", session, simulated_steps(session, longest))


def _simulated(options: LiveOptions, name: str) -> SessionSetup:
    """The same session with a simulated human, whose judgement and hands are those of a preset."""
    human, agent, hyper = HUMAN_PRESETS[name], options.agent, options.hyper
    agent = dataclasses.replace(
        agent, **{part: human[part] for part in ("danger", "release", "human_actions")}
    )
    judging = {part: human[part] for part in ("tolerance", "delay")}
    hyper = dataclasses.replace(
        hyper,
        takeover_steps=human["takeover_steps"],
        human=dataclasses.replace(hyper.human, **judging),
    )
    watched = dataclasses.replace(
        options, mode="watch", agent=agent, hyper=hyper, human_policy=None
    )
    setup = setup_of(watched)
    if options.mode == "test":
        setup = setup._replace(learns=False, hyper=frozen(setup.hyper, human_present=True))
    return setup


def _told(name: str, session: Session, steps: Steps, answers: Sequence[float] = ()) -> Participant:
    rows, alarmed, dangerous = session.episodes, steps.alarmed, steps.dangerous
    fit = fits_of(steps)["threshold"] if dangerous.any() else None
    return Participant(
        name=name,
        minutes=session.env_steps / RATE / 60,
        episodes=len(rows),
        falls=sum(row["fall"] for row in rows),
        mean_return=_mean([row["return"] for row in rows]),
        dangerous=_mean(dangerous),
        alarms=int(alarmed.sum()),
        agreed=_mean(dangerous[alarmed]),
        human_seconds=int(steps.human_action.sum()) / RATE,
        tolerance=_NAN if fit is None else fit.tolerance,
        delay=_NAN if fit is None else fit.delay,
        disagrees=_NAN if fit is None else fit.disagrees,
        workload=_mean(answers),
        answers=tuple(answers) or (_NAN,) * len(SCALES),
    )


def _mean(values: Sequence[float] | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else _NAN


def csv_table(participants: Sequence[Participant]) -> Table:
    """A column for each number, and for each of `guide.SCALES`."""
    names = [name for name in Participant._fields if name != "answers"]
    columns = {name: np.array([getattr(one, name) for one in participants]) for name in names}
    answers = np.array([one.answers for one in participants], float)
    return columns | dict(zip(SCALES, answers.T, strict=True))


def report(participants: Sequence[Participant]) -> str:
    """A Markdown table, a line for each human."""
    head = [
        *("human", "minutes", "episodes", "falls", "mean return", "judged dangerous"),
        *("alarms [steps]", "agreed with", "human actions [s]", "danger from [rad]"),
        *("delay [s]", "disagrees", "workload"),
    ]

    def shown(value: float, text: str) -> str:
        return "" if np.isnan(value) else format(value, text)

    lines = [
        [
            one.name,
            f"{one.minutes:.1f}",
            str(one.episodes),
            str(one.falls),
            shown(one.mean_return, ".0f"),
            shown(one.dangerous, ".1%"),
            str(one.alarms),
            shown(one.agreed, ".0%"),
            f"{one.human_seconds:.0f}",
            shown(one.tolerance, ".2f"),
            shown(one.delay / RATE, ".2f"),
            shown(one.disagrees, ".1%"),
            shown(one.workload, ".0f"),
        ]
        for one in participants
    ]
    return table([head, *lines])
