"""A session with a page in simulated time, for the tests of pages that stop answering."""

import asyncio
import json
import selectors

import pytest
from live_team import play, setup_of

from hitl_jax.live import journal, messages, pacing
from hitl_jax.live.pacing import PacedSession
from hitl_jax.live.page_updates import PageOptions
from hitl_jax.live.session import Session

LIMIT = 1.0
FRAME = 1 / pacing.RATE
SILENT_FRAMES = pytest.approx(LIMIT / FRAME, abs=5)


class _Selector(selectors.DefaultSelector):
    """Returns from each wait at once, and adds its time to `now`."""

    now = 0.0

    def select(self, timeout=None):
        self.now += timeout or 0.0
        return super().select(0)


class SimulatedPage:
    """A page that answers each frame a little later, unless it is `dead`."""

    def __init__(self, paced, late=0.02):
        self.paced, self.late, self.dead, self.told = paced, late, False, []

    def hear(self, message):
        self.told.append(message)
        if message["type"] == "frame":
            loop = asyncio.get_running_loop()
            loop.call_later(self.late, self.say, "seen", message["n"])

    def say(self, kind, frame=None, **fields):
        """Sends a message of the person, unless the page is dead."""
        if not self.dead:
            said = fields if frame is None else {**fields, "frame": frame}
            self.paced.handle(messages.parse(json.dumps({"type": kind, **said})))

    def last(self, kind):
        """The last update of a type."""
        return next(m for m in reversed(self.told) if m["type"] == kind)


class SimulatedSession:
    """What a test sees: the session, its pace, and the page that controls."""

    def __init__(self, session, noted, selector, options):
        self.session, self.paced = session, PacedSession(session, noted, options)
        self.selector, self.page = selector, SimulatedPage(self.paced)
        self.lines = []

    def come(self, page):
        """A page opens and has control."""
        self.page = page
        self.paced.add_listener(page.hear)
        self.paced.connect_person()

    def go(self):
        """The page closes."""
        self.paced.remove_listener(self.page.hear)
        self.paced.disconnect_person()

    @property
    def number(self):
        return self.session.frame.number

    def said(self, kind):
        """The messages of a type in the journal."""
        return [line["said"] for line in self.lines if line.get("said", {}).get("type") == kind]


def simulate(happens, path, monkeypatch, setup, asks, mode):
    """Runs a session in simulated time; then its journal must play it again.

    Args:
        happens: a coroutine function of the `SimulatedSession`: what the test does.
        path: of the journal.
        monkeypatch: pytest's.
        setup: of the session; by default with a person, without learning.
        asks: whether the walker asks.
        mode: of the page.
    """
    setup = setup or setup_of(learns=False)
    noted = journal.Journal(path)
    noted.begin({})
    selector = _Selector()
    options = PageOptions(mode, "", asks, 5.0, LIMIT)
    one = SimulatedSession(Session(setup), noted, selector, options)

    def begin():
        loop = asyncio.SelectorEventLoop(selector)
        loop.time = lambda: selector.now
        return loop

    async def play_it():
        playing = asyncio.create_task(one.paced.run())
        one.come(one.page)
        await asyncio.sleep(0.5)
        await happens(one)
        playing.cancel()

    monkeypatch.setattr(pacing, "_clock", lambda: selector.now)
    with asyncio.Runner(loop_factory=begin) as runner:
        runner.run(play_it())
    noted.close()
    again = Session(setup)
    list(journal.play(again, journal.read(path)[1], path))
    play(again, one.number)
    assert again.digest() == one.session.digest()
    assert again.labels == one.session.labels
    one.lines = journal.read(path)[1]
    return one
