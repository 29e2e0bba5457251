"""What a person did in a live session, as a human for sweeps: `hitl-jax recorded`.

    hitl-jax recorded runs/live/session.jsonl
    hitl-jax sweep --human recorded:runs/live/session.jsonl.human.npz

Plays the session again, writes the person's judgements step by step, and says which simulated human
they are most like.
"""

import dataclasses
import pathlib
from typing import NamedTuple

import jax
import numpy as np
import tyro

from hitl_jax.commands.live import LiveOptions, setup_of, tell_differences
from hitl_jax.config import AgentConfig, Hyper
from hitl_jax.console.cli import checking_input
from hitl_jax.errors import ResultsError
from hitl_jax.human.fit import FittedHuman, fit_human
from hitl_jax.human.indicator import hull_angle, weighted
from hitl_jax.human.judgement import HumanParams
from hitl_jax.live import journal
from hitl_jax.live.labels import judged, unjudged
from hitl_jax.live.session import Session
from hitl_jax.results.config_diff import completed
from hitl_jax.results.json_documents import options_of
from hitl_jax.sweep import recorded_human
from hitl_jax.sweep.compile_cache import keep_programs
from hitl_jax.training.run_spec import LoopConfig


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


@dataclasses.dataclass(frozen=True)
class _Begun:
    """The first line of a journal; the files are told by their digests."""

    journal: int
    mode: str
    method: str
    seed: int
    start: str | None
    human_policy: str | None
    agent: AgentConfig
    loop: LoopConfig
    hyper: Hyper


class Steps(NamedTuple):
    """The steps of a session that a person judged.

    Attributes:
        observation: s_t, [T, O].
        begins: whether an episode, or the rest of it after steps that nobody judged, begins here,
            bool [T].
        alarmed: C, bool [T].
        dangerous: h_t = 0 as it stands at the end, bool [T].
        episodes: how many there were.
        unjudged: how many steps nobody judged.
    """

    observation: np.ndarray
    begins: np.ndarray
    alarmed: np.ndarray
    dangerous: np.ndarray
    episodes: int
    unjudged: int


def main(options: RecordedOptions) -> int:
    """Plays the session again, writes the judgements, and compares.

    Args:
        options: which.

    Returns:
        The exit code.
    """
    path = pathlib.Path(options.journal)
    header, lines = journal.read(path)
    with checking_input():
        session_options = _options(header, options)
        asked = session_options.header()
        for name in ("start", "human_policy"):
            if asked[name] != header.get(name):
                given = getattr(options, name)
                flag = name.replace("_", "-")
                raise ValueError(f"--{flag} {given}: the session had {header.get(name)}")
        if not session_options.with_person:
            raise ValueError(f"{path}: --mode watch: no person judged in this session")
        setup = setup_of(session_options)
    tell_differences(path, header)
    keep_programs()
    steps = steps_of(Session(setup), lines, path)
    if not len(steps.dangerous):
        raise ResultsError(f"{path}: no step was played that a person judged")
    out = path.with_name(f"{path.name}.human.npz")
    recorded_human.write(out, steps.dangerous)
    print("\n".join(report_of(steps)))
    print(f"\nThe person as a human for sweeps: --human {recorded_human.PREFIX}{out}")
    return 0


def _options(header: journal.Line, options: RecordedOptions) -> LiveOptions:
    """The options of a session, from its journal."""
    try:
        told = {name: value for name, value in header.items() if name != "made"}
        begun = options_of(completed(told), _Begun)
    except ValueError as error:
        raise ValueError(f"{options.journal}: is no journal of a live session: {error}") from error
    return LiveOptions(
        mode=begun.mode,
        start=options.start,
        method=begun.method,
        seed=begun.seed,
        human_policy=options.human_policy,
        agent=begun.agent,
        loop=begun.loop,
        hyper=begun.hyper,
    ).checked()


def steps_of(session: Session, lines: list[journal.Line], path: pathlib.Path) -> Steps:
    """Plays a journal again; the steps that a person judged.

    Args:
        session: at its beginning.
        lines: of the journal.
        path: of the journal, for error texts.

    Raises:
        ResultsError: if the session does not become what it was.
    """
    seen, begins, alarmed, live = [], [], [], []

    def note() -> None:
        frame = session.frame
        seen.append(frame.observation)
        begins.append(frame.step == 0)
        alarmed.append(frame.alarmed)
        live.append(not frame.ended)

    for _ in journal.play(session, lines, path, before_step=note):
        pass
    dangerous = judged(session.labels, 0, len(live))
    nobodys = unjudged(session.labels, 0, len(live))
    after = np.concatenate([[False], nobodys])[:-1]
    live_steps = np.array(live, bool)
    kept = live_steps & ~nobodys
    return Steps(
        observation=np.array(seen)[kept],
        begins=(np.array(begins, bool) | after)[kept],
        alarmed=np.array(alarmed, bool)[kept],
        dangerous=dangerous[kept],
        episodes=sum(begins),
        unjudged=int((live_steps & nobodys).sum()),
    )


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
    lines += [
        "",
        "| simulated human | tolerance [rad] | delay [steps] | misses | fears | disagrees |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    horizon = HumanParams().horizon
    signals = {"threshold": hull_angle, "predictive": weighted(1.0, horizon)}
    fits: dict[str, FittedHuman] = {}
    for name, signal in signals.items():
        values = np.abs(np.asarray(jax.vmap(signal)(steps.observation)))
        fit = fits[name] = fit_human(values, steps.begins, dangerous)
        lines.append(
            f"| {name} | {fit.tolerance:.3f} | {fit.delay} | {fit.missed:.1%} | {fit.feared:.1%} "
            f"| {fit.disagrees:.2%} |"
        )
    best = min(fits, key=lambda name: fits[name].disagrees)
    fit = fits[best]
    lines += [
        "",
        f"Nearest: --danger {best} --human.tolerance {fit.tolerance:.3f} --human.delay {fit.delay} "
        f"--human.mistake-rate {fit.disagrees:.4f}",
    ]
    return lines
