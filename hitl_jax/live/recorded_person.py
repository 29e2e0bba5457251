"""A person of a live session: the steps that they judged, and the simulated human nearest them."""

import dataclasses
import pathlib
from typing import NamedTuple

import jax
import numpy as np

from hitl_jax.choices.registry import require_trusted
from hitl_jax.config import AgentConfig, Hyper
from hitl_jax.errors import InvalidValue, ResultsError
from hitl_jax.human.fit import FittedHuman, fit_human
from hitl_jax.human.indicator import hull_angle, weighted
from hitl_jax.human.judgement import HumanParams
from hitl_jax.live import journal
from hitl_jax.live.begin import setup_of
from hitl_jax.live.labels import judged, unjudged
from hitl_jax.live.options import LiveOptions
from hitl_jax.live.session import Frame, Session
from hitl_jax.live.setup import SessionSetup
from hitl_jax.results.config_diff import completed
from hitl_jax.results.json_documents import options_of
from hitl_jax.training.run_spec import LoopConfig


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
    """The steps of a session that a human judged.

    Attributes:
        observation: s_t, [T, O].
        begins: whether an episode, or the rest of it after steps that nobody judged, begins here,
            bool [T].
        alarmed: C, bool [T].
        dangerous: h_t = 0 as it stands at the end, bool [T]; so is human control.
        human_action: whether the human's action was executed, bool [T].
        episodes: how many there were.
        unjudged: how many steps nobody judged.
    """

    observation: np.ndarray
    begins: np.ndarray
    alarmed: np.ndarray
    dangerous: np.ndarray
    human_action: np.ndarray
    episodes: int
    unjudged: int


def setup_again(
    path: pathlib.Path, header: journal.Line, start: str | None, human_policy: str | None
) -> SessionSetup:
    """What a session began with, from its journal.

    Args:
        path: of the journal.
        header: its first line.
        start: the `params.npz` that it began with, if it began with one.
        human_policy: the `params.npz` of its assistant, if it had one.

    Raises:
        ResultsError: one line, if it is no journal of a session in which a person judged.
        ValueError: one line, if the files are others.
    """
    return setup_of(options_again(path, header, start, human_policy))


def options_again(
    path: pathlib.Path, header: journal.Line, start: str | None, human_policy: str | None
) -> LiveOptions:
    """The options of a session in which a person judged, from its journal; see `setup_again`."""
    options = options_from(path, header, start, human_policy)
    asked = options.header()
    for name, given in (("start", start), ("human_policy", human_policy)):
        if asked[name] != header.get(name):
            raise InvalidValue(name, given, f"the session had {header.get(name)}")
    if not options.with_person:
        raise ResultsError(f"{path}: mode watch: no person judged in this session")
    return options


def options_from(
    path: pathlib.Path, header: journal.Line, start: str | None, human_policy: str | None
) -> LiveOptions:
    """The options of any session, from its journal; see `setup_again`."""
    try:
        told = {name: value for name, value in header.items() if name != "made"}
        begun = options_of(completed(told), _Begun)
    except ValueError as error:
        raise ResultsError(f"{path}: is no journal of a live session: {error}") from error
    require_trusted(path, vars(begun.agent))
    return LiveOptions(
        mode=begun.mode,
        start=start,
        method=begun.method,
        seed=begun.seed,
        human_policy=human_policy,
        agent=begun.agent,
        loop=begun.loop,
        hyper=begun.hyper,
    ).checked()


def steps_of(session: Session, lines: list[journal.Line], path: pathlib.Path) -> Steps:
    """Plays a session again, and takes the steps that a person judged.

    Args:
        session: at its beginning.
        lines: of its journal.
        path: of the journal.

    Raises:
        ResultsError: if it does not come out as it was noted.
    """
    noted = _Noted(session)
    for _ in journal.play(session, lines, path, before_step=noted.before_step):
        pass
    count = session.frame.number
    return noted.steps(judged(session.labels, 0, count), unjudged(session.labels, 0, count))


def simulated_steps(session: Session, env_steps: int) -> Steps:
    """Plays a session with a simulated human, and takes all its steps.

    Args:
        session: at its beginning.
        env_steps: how many environment steps are played.
    """
    noted, dangerous = _Noted(session), []
    while session.env_steps < env_steps:
        noted.before_step()
        session.tick()
        last = session.frame.number - 1
        dangerous.append(session.flag("dangerous", last) or session.flag("control", last))
    return noted.steps(np.array(dangerous, bool), np.zeros(len(dangerous), bool))


class _Noted:
    """What a session shows of each frame, taken while it is still kept."""

    def __init__(self, session: Session):
        self._session = session
        self._frames: list[Frame] = []
        self._human_action: list[bool] = []

    def before_step(self) -> None:
        """Notes the frame that comes next."""
        self._note_last()
        self._frames.append(self._session.frame)

    def _note_last(self) -> None:
        if self._frames:
            flag = self._session.flag("human_action", self._frames[-1].number)
            self._human_action.append(flag)

    def steps(self, dangerous: np.ndarray, nobodys: np.ndarray) -> Steps:
        """The steps that were judged; whether so, and which nobody judged, is bool [frames]."""
        self._note_last()
        frames = self._frames
        begins = np.array([frame.step == 0 for frame in frames], bool)
        live = np.array([not frame.ended for frame in frames], bool)
        after = np.concatenate([[False], nobodys])[:-1]
        kept = live & ~nobodys
        return Steps(
            observation=np.array([frame.observation for frame in frames])[kept],
            begins=(begins | after)[kept],
            alarmed=np.array([frame.alarmed for frame in frames], bool)[kept],
            dangerous=dangerous[kept],
            human_action=np.array(self._human_action, bool)[kept],
            episodes=int(begins.sum()),
            unjudged=int((live & nobodys).sum()),
        )


def fits_of(steps: Steps) -> dict[str, FittedHuman]:
    """The simulated human nearest the person, by its test of danger; see `fit_human`."""
    signals = {"threshold": hull_angle, "predictive": weighted(1.0, HumanParams().horizon)}
    return {
        name: fit_human(
            np.abs(np.asarray(jax.vmap(signal)(steps.observation))), steps.begins, steps.dangerous
        )
        for name, signal in signals.items()
    }
