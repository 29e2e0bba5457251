"""Gives a session its pace, and tells all who watch; one task of one event loop, no threads."""

import asyncio
import contextlib
import statistics
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from hitl_jax.envs.visible_walker import FEET, LIDAR, shapes
from hitl_jax.errors import ResultsError, WalkerError
from hitl_jax.human.indicator import INDICATORS
from hitl_jax.live import messages
from hitl_jax.live.attention import Attention
from hitl_jax.live.journal import Journal
from hitl_jax.live.session import Session

RATE = 50.0
"""Steps a second of real time."""

_SLICE = 0.015
"""For how long a session that is to be quick plays before others have their turn [s]."""
_STATUS_EVERY = 0.25
_LOOK_EVERY = 0.05
_clock = time.monotonic
_UNITS = {"hull_angle": "rad", "hull_angular_velocity": "1", "weighted": "rad"}

Message = dict[str, Any]


class Manners(NamedTuple):
    """How a session is shown.

    Attributes:
        mode: `train`, `test` or `watch`.
        title: for people.
        asks: whether the walker stops and asks where an alarm begins.
        answer_seconds: how long it waits for an answer; then it goes on, which counts as safe.
        silence_seconds: for how long the page of a person may leave frames unanswered; then nobody
            is there.
    """

    mode: str
    title: str
    asks: bool
    answer_seconds: float
    silence_seconds: float = 1.0


class Conductor:
    """Plays a session in time; see the module."""

    def __init__(self, session: Session, journal: Journal, manners: Manners):
        """Takes a session over; `run` plays it.

        Args:
            session: what is played.
            journal: where all of it is noted.
            manners: how it is shown.
        """
        self._session, self._journal, self._manners = session, journal, manners
        self._listeners: list[Callable[[Message], None]] = []
        self._paused = False
        self._why_paused: str | None = None
        self._away = True
        self._attention = Attention(manners.silence_seconds)
        self._steps_due = 0
        self._speed: float | None = 1.0
        self._asked: int | None = None
        self._left = 0.0
        self._noticed = False
        self._failure: ResultsError | None = None
        self._woken = asyncio.Event()
        self._reactions: list[float] = []
        self._alarm_since: float | None = None
        self._recent: deque[float] = deque(maxlen=int(RATE))

    # Who watches.

    def listen(self, listener: Callable[[Message], None]) -> None:
        """Tells somebody everything from now on, and first where things stand."""
        self._listeners.append(listener)
        for message in (self._hello(), self._history(), self._terrain(), self._frame()):
            listener(message)
        self._tell(self._status())

    def forget(self, listener: Callable[[Message], None]) -> None:
        """Tells somebody no more."""
        self._listeners.remove(listener)
        self._tell(self._status())

    def leave(self) -> None:
        """The person has gone: nothing is played until somebody comes."""
        self._let_go()
        self._away = True
        self._tell(self._status())

    def come(self) -> None:
        """A person's page is there: once it has shown a frame, it goes on as it was."""
        self._attention.begin(self._session.frame.number)
        if self._session.setup.with_person:
            self._tell(self._status())
        else:
            self._hear(None)  # Nobody needs to see what a simulated human judges.
        self._show()

    def _hear(self, frame: int | None) -> None:
        """The page of the person says something: they are there."""
        self._attention.hear(frame)
        if self._away:
            self._away = False
            self._recent.clear()
            self._woken.set()
            self._tell(self._status())

    def _let_go(self) -> None:
        """Ends what the person held with the frame that they saw last."""
        session, attention = self._session, self._attention
        self._alarm_since = None  # Or how long nobody was there would count as a reaction.
        if session.setup.with_person and not self._away:
            self._note({"type": "gone", "frame": attention.seen})
            attention.settle(session.frame.number)

    def _lose(self) -> None:
        """The page of the person answers no more."""
        first, last = self._attention.seen + 1, self._session.frame.number - 1
        self._let_go()
        self._paused, self._steps_due = True, 0
        said = (
            f"Paused: the page in control did not answer for {self._manners.silence_seconds:g} s "
            "(hidden, asleep or cut off). What was held was let go."
        )
        if first <= last:
            said += f" Nobody judged frames {first} to {last}."
        self._why_paused = self._why_paused or said
        self._recent.clear()
        self._tell(self._status())
        self._show()

    # What the person says.

    def say(self, command: messages.Command) -> None:
        """Does what a person said, and notes it.

        Raises:
            ValueError: one line, where it cannot be done.
        """
        kind = command["type"]
        if kind == "seen":
            self._attention.answer(command["frame"])
            self._hear(command["frame"])
            return
        self._note(command)
        self._hear(command.get("frame"))
        if kind in ("pause", "speed"):
            self._recent.clear()  # Or the rate would mix paces.
        if kind == "pause":
            self._paused = command["on"]
            self._why_paused = self._why_paused if self._paused else None
            self._alarm_since = None
        elif kind == "step":
            self._steps_due += self._paused
        elif kind == "speed":
            self._speed = command["factor"]
        elif kind in ("danger", "take", "safe") and command.get("down", True):
            self._react()
            self._asked = None
        self._woken.set()
        self._tell(self._status())
        if self._waits():
            self._show()

    def _note(self, command: messages.Command) -> None:
        """Has it done and noted. What cannot be noted ends the session, whoever said it."""
        try:
            self._journal.said(self._session, command)
        except ResultsError as error:
            self._failure = error

    def _react(self) -> None:
        """How long after the alarm was first shown it was answered."""
        if self._alarm_since is not None:
            self._reactions.append(1000 * (_clock() - self._alarm_since))
            self._alarm_since = None

    # Time.

    async def run(self) -> None:
        """Plays for ever; ends when it is cancelled, or says why it cannot go on.

        Raises:
            ResultsError: if the journal cannot be written.
            WalkerError: if the learner diverged.
        """
        watching = asyncio.create_task(self._watch())
        try:
            await self._run()
        except (ResultsError, WalkerError) as error:
            self._tell({"type": "error", "message": f"The session has ended. {error}"})
            raise
        finally:
            watching.cancel()

    async def _watch(self) -> None:
        """Looks whether the person is still there, where a person is needed."""
        then = _clock()
        while self._session.setup.with_person:
            await asyncio.sleep(_LOOK_EVERY)
            now = _clock()
            if not self._away and self._attention.is_lost(now - then):
                self._lose()
            then = now

    async def _run(self) -> None:
        due = told = _clock()
        while True:
            if self._failure is not None:
                raise self._failure
            if self._waits():
                due = await self._wait()
            else:
                self._play(until=_clock() + _SLICE if self._speed is None else None)
                due = self._next(due)
                await asyncio.sleep(max(due - _clock(), 0.0))
            if _clock() - told >= _STATUS_EVERY:
                told = _clock()
                self._tell(self._status())

    def _waits(self) -> bool:
        held = self._paused and not self._steps_due
        return self._away or held or self._asked is not None

    async def _wait(self) -> float:
        """Waits for a command, and counts down while it asks; when the next step is due."""
        before = _clock()
        self._woken.clear()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._woken.wait(), _STATUS_EVERY)
        if self._asked is not None and not self._paused and not self._away:
            self._left -= _clock() - before
            if self._left <= 0:
                self._note({"type": "no_answer", "frame": self._asked})
                self._asked = None
        return _clock()

    def _next(self, due: float) -> float:
        """When the step after the one that was due is to be made; time that was lost is lost."""
        if self._speed is None:
            return _clock()
        period = 1.0 / (RATE * self._speed)
        return max(due + period, _clock() - period)

    def _play(self, until: float | None) -> None:
        """A step, or as many as can be made until then, and shows the last."""
        while True:
            self._step()
            if self._waits() or until is None or _clock() >= until:
                break
        self._show()

    def _step(self) -> None:
        session = self._session
        self._steps_due = max(self._steps_due - 1, 0)
        row = session.tick()
        self._journal.played(session)
        self._recent.append(_clock())
        frame = session.frame
        if row is not None:
            self._tell({"type": "episode", **_shown_row(row)})
        if frame.step == 0 and not frame.ended:
            self._tell(self._terrain())
        if not frame.alarmed:
            self._noticed, self._alarm_since = False, None
        elif not self._noticed and self._alarm_since is None and not session.controls:
            self._alarm_since = _clock()
            self._noticed = True
            if self._manners.asks:
                self._asked, self._left = frame.number, self._manners.answer_seconds

    # What is told.

    def _tell(self, message: Message) -> None:
        for listener in list(self._listeners):
            listener(message)

    def _show(self) -> None:
        """Tells the frame that comes next; the page of the person is to answer it."""
        self._attention.show(self._session.frame.number)
        self._tell(self._frame())

    def _hello(self) -> Message:
        setup, manners = self._session.setup, self._manners
        name = setup.agent.config.indicator
        return {
            "type": "hello",
            "mode": manners.mode,
            "title": manners.title,
            "indicator": name if name in INDICATORS else "indicator",
            "unit": _UNITS.get(name, "1"),
            "span": 1.0,
            "intervention": setup.agent.config.intervention,
            "answer_seconds": manners.answer_seconds,
            "no_answer": "Without an answer it counts as safe, and the walker goes on.",
            **shapes(),
        }

    def _history(self) -> Message:
        rows = [_shown_row(row) for row in self._session.episodes]
        return {"type": "history", "episodes": rows}

    def _terrain(self) -> Message:
        frame = self._session.frame
        return {"type": "terrain", "episode": frame.episode, **self._session.plant.terrain()}

    def _frame(self) -> Message:
        session = self._session
        frame = session.frame
        watched = not session.setup.with_person
        before = max(frame.number - 1, 0)
        simulated = watched and session.flag("control", before)
        judged = session.flag("dangerous", before) if watched else session.dangerous
        control = "person" if session.controls else "human" if simulated else "machine"
        return {
            "type": "frame",
            "n": frame.number,
            "episode": frame.episode,
            "step": frame.step,
            "bodies": session.plant.bodies(),
            "lidar": [round(float(share), 4) for share in frame.observation[LIDAR]],
            "feet": [bool(frame.observation[foot]) for foot in FEET],
            "c": round(frame.indicator, 4),
            "tau": round(frame.boundary, 4) if session.setup.hyper.has_arbiter else None,
            "alarm": frame.alarmed,
            "danger": judged,
            "control": control,
            "return": round(session.returned, 2),
            "interventions": session.interventions,
            "steps": session.env_steps,
        }

    def _status(self) -> Message:
        session, recent, reactions = self._session, self._recent, self._reactions
        moving = len(recent) > 1 and not self._waits()
        asking = None if self._asked is None else {"frame": self._asked, "left": self._left}
        said = [label for label in session.labels if label.cause is None and label.kind != "nobody"]
        return {
            "type": "status",
            "paused": self._paused or self._away,
            "why_paused": self._why_paused,
            "speed": self._speed,
            "asking": asking,
            "watchers": max(len(self._listeners) - 1, 0),
            "labels": len(said),
            "reaction_ms": round(reactions[-1]) if reactions else None,
            "median_reaction_ms": round(statistics.median(reactions)) if reactions else None,
            "rate": round((len(recent) - 1) / (recent[-1] - recent[0]), 1) if moving else 0.0,
            "learner": f"{session.updates:,} updates",
            "danger_held": session.dangerous and not session.controls,
        }


def _shown_row(row: dict[str, Any]) -> Message:
    ends = {"human-reset": "human", "time-limit": "time limit"}
    return {
        "episode": row["episode"],
        "return": round(row["return"], 2),
        "boundary": round(row["final_boundary"], 4),
        "interventions": row["interventions"],
        "length": row["length"],
        "end": ends.get(row["end"], row["end"]),
    }
