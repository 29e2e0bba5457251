"""Plays a session in real time and shows it to listeners, in one task of one event loop."""

import asyncio
import contextlib
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterable

from hitl_jax.errors import ResultsError, WalkerError
from hitl_jax.live import page_updates
from hitl_jax.live.guide import Guide, Stage, agreement
from hitl_jax.live.journal import Journal
from hitl_jax.live.messages import PersonMessage
from hitl_jax.live.page_updates import PageOptions, PageUpdate
from hitl_jax.live.session import Session
from hitl_jax.live.silence_timer import SilenceTimer

RATE = 50.0
"""Steps a second of real time."""

Listener = Callable[[PageUpdate], None]

COME_BACK_SECONDS = 5.0
"""How long a page that was lost can come back as it was [s]."""

_SLICE = 0.015
"""How long a session at full speed plays before other tasks have their turn [s]."""
_STATUS_EVERY = 0.25
_SILENCE_CHECK_EVERY = 0.05
_clock = time.monotonic


class PacedSession:
    """Plays a session at a pace, asks the person, and pauses when nobody is there."""

    def __init__(
        self,
        session: Session,
        journal: Journal,
        options: PageOptions,
        said: Iterable[str] = (),
    ):
        """Takes a session; `run` plays it.

        Args:
            session: what is played.
            journal: where all of it is written.
            options: how it is shown.
            said: types of the messages that the journal has already.
        """
        self._session, self._journal, self._options = session, journal, options
        self._listeners: list[Listener] = []
        self._guide = Guide(options.guide, said)
        self._paused = False
        self._why_paused: str | None = None
        self._away, self._left_at = True, _clock()
        self._silence = SilenceTimer(options.silence_seconds)
        self._steps_due = 0
        self._speed: float | None = 1.0
        self._asked_frame: int | None = None
        self._answer_seconds_left = 0.0
        self._alarm_shown = False
        self._failure: ResultsError | None = None
        self._changed = asyncio.Event()
        self._reactions: list[float] = []
        self._alarm_since: float | None = None
        self._step_times: deque[float] = deque(maxlen=int(RATE))

    @property
    def is_guided(self) -> bool:
        """Whether the page leads a person."""
        return self._options.guide is not None

    # Pages that come and go.

    def add_listener(self, listener: Listener) -> None:
        """Sends all updates to a listener from now on, beginning with the state of the session."""
        self._listeners.append(listener)
        session = self._session
        listener(page_updates.hello(session, self._options))
        for make in (page_updates.history, page_updates.terrain, page_updates.frame):
            listener(make(session))
        self._send(self._status())

    def remove_listener(self, listener: Listener) -> None:
        """Sends a listener no more updates."""
        self._listeners.remove(listener)
        self._send(self._status())

    def connect_person(self) -> None:
        """The page of a person is open: it plays on once the page has shown a frame."""
        self._silence.start(self._session.frame.number)
        if self._session.setup.with_person:
            self._send(self._status())
        else:
            self._hear(None)  # A simulated human judges: nobody has to see the frames.
        self._show()

    def disconnect_person(self) -> None:
        """The page of the person is closed: nothing is played until another one opens."""
        self._release()
        self._away, self._left_at = True, _clock()
        self._send(self._status())

    def _hear(self, frame: int | None) -> None:
        """Notes a message of the person's page: somebody is there."""
        self._silence.hear(frame)
        if self._away:
            self._away = False
            self._step_times.clear()
            self._changed.set()
            self._send(self._status())

    def _release(self) -> None:
        """Ends what the person held, after the last frame that they saw."""
        session = self._session
        self._alarm_since = None  # Or the time in which nobody was there would count as a reaction.
        if session.setup.with_person and not self._away:
            self._do({"type": "gone", "frame": self._silence.seen})
            self._silence.skip_to(session.frame.number)

    def _pause_in_silence(self) -> None:
        """Pauses, since the page of the person stopped answering."""
        first, last = self._silence.seen + 1, self._session.frame.number - 1
        self._release()
        self._paused, self._steps_due = True, 0
        reason = (
            f"Paused: the page in control did not answer for {self._options.silence_seconds:g} s "
            "(hidden, asleep or cut off). What was held was let go."
        )
        if first <= last:
            reason += f" Nobody judged frames {first} to {last}."
        self._why_paused = self._why_paused or reason
        self._step_times.clear()
        self._send(self._status())
        self._show()

    # Messages of the person.

    def handle(self, message: PersonMessage) -> None:
        """Does what a person said, and writes it to the journal.

        Raises:
            ValueError: one line, where it cannot be done.
        """
        kind = message["type"]
        if kind == "seen":
            self._silence.answer(message["frame"])
            self._hear(message["frame"])
            return
        self._guide.hear(kind, self._session.env_steps)
        if kind == "consent" and self._options.guide is not None:
            message = agreement(self._options.guide)
        self._do(message)
        self._hear(message.get("frame"))
        if kind in ("pause", "speed"):
            self._step_times.clear()  # Or the shown rate would be an average of two paces.
        if kind == "pause":
            self._paused = message["on"]
            self._why_paused = self._why_paused if self._paused else None
            self._alarm_since = None
        elif kind == "step":
            self._steps_due += self._paused
        elif kind == "speed":
            self._speed = message["factor"]
        elif kind in ("danger", "take", "safe") and message.get("down", True):
            self._measure_reaction()
            self._asked_frame = None
        self._changed.set()
        self._send(self._status())
        if self._waits():
            self._show()

    def _do(self, message: PersonMessage) -> None:
        """Does and writes a message; if it cannot be written, `run` raises that and ends."""
        try:
            self._journal.said(self._session, message)
        except ResultsError as error:
            self._failure = error

    def _measure_reaction(self) -> None:
        """Measures the time from when the alarm was first shown."""
        if self._alarm_since is not None:
            self._reactions.append(1000 * (_clock() - self._alarm_since))
            self._alarm_since = None

    # Time.

    async def run(self) -> None:
        """Plays until it is cancelled or cannot go on.

        Raises:
            ResultsError: if the journal cannot be written.
            WalkerError: if the learner diverged.
        """
        watching = asyncio.create_task(self._watch_silence())
        try:
            await self._run()
        except (ResultsError, WalkerError) as error:
            self._send({"type": "error", "message": f"The session has ended. {error}"})
            raise
        finally:
            watching.cancel()

    async def _watch_silence(self) -> None:
        """Pauses the session when the page of a person stops answering."""
        then = _clock()
        while self._session.setup.with_person:
            await asyncio.sleep(_SILENCE_CHECK_EVERY)
            now = _clock()
            if not self._away and self._silence.advance(now - then):
                self._pause_in_silence()
            then = now

    async def _run(self) -> None:
        due = told = _clock()
        while True:
            if self._failure is not None:
                raise self._failure
            if self._stage == "end" and self._away and _clock() > self._left_at + COME_BACK_SECONDS:
                return
            if self._waits():
                due = await self._wait()
            else:
                self._play(until=_clock() + _SLICE if self._speed is None else None)
                due = self._next_due(due)
                await asyncio.sleep(max(due - _clock(), 0.0))
            if _clock() - told >= _STATUS_EVERY:
                told = _clock()
                self._send(self._status())

    def _waits(self) -> bool:
        """Whether no step is to be played now."""
        paused = self._paused and not self._steps_due
        stands = paused or self._asked_frame is not None or self._stage != "play"
        return self._away or stands

    @property
    def _stage(self) -> Stage:
        return self._guide.stage(self._session.env_steps)

    async def _wait(self) -> float:
        """Waits for a change, and counts down while the walker asks; when the next step is due."""
        before = _clock()
        self._changed.clear()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._changed.wait(), _STATUS_EVERY)
        if self._asked_frame is not None and not self._paused and not self._away:
            self._answer_seconds_left -= _clock() - before
            if self._answer_seconds_left <= 0:
                self._do({"type": "no_answer", "frame": self._asked_frame})
                self._asked_frame = None
        return _clock()

    def _next_due(self, due: float) -> float:
        """When the step after the one that was due is to be played; lost time is not made up."""
        if self._speed is None:
            return _clock()
        period = 1.0 / (RATE * self._speed)
        return max(due + period, _clock() - period)

    def _play(self, until: float | None) -> None:
        """Plays a step, or as many as fit before a time, and shows the last."""
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
        self._step_times.append(_clock())
        frame = session.frame
        if row is not None:
            self._send(page_updates.episode(row))
        if frame.step == 0 and not frame.ended:
            self._send(page_updates.terrain(session))
        if not frame.alarmed:
            self._alarm_shown, self._alarm_since = False, None
        elif not self._alarm_shown and self._alarm_since is None and not session.person.in_control:
            self._alarm_since = _clock()
            self._alarm_shown = True
            if self._options.asks:
                self._asked_frame = frame.number
                self._answer_seconds_left = self._options.answer_seconds
        if self._stage != "play":
            self._release()
            self._asked_frame = None

    # Updates for pages.

    def _send(self, update: PageUpdate) -> None:
        for listener in list(self._listeners):
            listener(update)

    def _show(self) -> None:
        """Sends the frame that comes next; the page of the person has to answer it."""
        self._silence.show(self._session.frame.number)
        self._send(page_updates.frame(self._session))

    def _status(self) -> PageUpdate:
        times, reactions, asked = self._step_times, self._reactions, self._asked_frame
        moving = len(times) > 1 and not self._waits()
        asking = None if asked is None else {"frame": asked, "left": self._answer_seconds_left}
        pace = {
            "paused": self._paused or self._away,
            "why_paused": self._why_paused,
            "speed": self._speed,
            "asking": asking,
            "stage": self._stage,
            "watchers": max(len(self._listeners) - 1, 0),
            "reaction_ms": round(reactions[-1]) if reactions else None,
            "median_reaction_ms": round(statistics.median(reactions)) if reactions else None,
            "rate": round((len(times) - 1) / (times[-1] - times[0]), 1) if moving else 0.0,
        }
        return page_updates.status(self._session, pace)
