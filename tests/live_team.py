"""A small session for the tests of the live page, and its server."""

import asyncio
import contextlib
import functools
import json
import socket
import threading
import time
import urllib.error
import urllib.request

import numpy as np
from paper_team import paper_config, paper_hyper
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from hitl_jax.config import Method, hyper_for
from hitl_jax.live import journal, person
from hitl_jax.live.pacing import PacedSession
from hitl_jax.live.page_updates import PageOptions
from hitl_jax.live.server import PageServer
from hitl_jax.live.setup import SessionSetup
from hitl_jax.team.agent import make_agent
from hitl_jax.training.run_spec import LoopConfig

TOKEN = "a-token"

HYPER = hyper_for(
    Method.HITL_AC,
    paper_hyper(warmup_steps=64, initial_boundary=0.1, delta_minus=0.01, delta_plus=0.01),
)


@functools.cache
def agent_of(intervention, with_person=True):
    """The same object each time, so that what it compiles is shared."""
    config = paper_config(
        learner="td3",
        hidden_sizes=(16,),
        batch_size=16,
        boundary_hidden_sizes=(8,),
        boundary_batch_size=8,
        tested_actor="average",
        intervention=intervention,
    )
    if not with_person:
        return make_agent(config)
    return make_agent(config, judge=person.judge(), source=person.actions(4))


def setup_of(intervention="takeover", with_person=True, **changes):
    """Of a session with a person, or with a simulated human; a replay of 512 frames."""
    setup = SessionSetup(
        agent=agent_of(intervention, with_person),
        hyper=HYPER,
        loop=LoopConfig(capacity=512),
        method=Method.HITL_AC,
        seed=0,
        with_person=with_person,
        learns=True,
    )
    return setup._replace(**changes)


class Served:
    """A session that is served in a thread; with a port, on that one.

    A journal that is there is gone on with: the session is then one that has played it.
    """

    def __init__(
        self,
        session,
        path,
        asks=False,
        answer_seconds=0.3,
        mode="train",
        port=0,
        silence_seconds=60.0,  # The machine may be slow.
        guide=None,
    ):
        self.session, self.path = session, path
        self._noted = journal.Journal(path)
        if self._noted.is_new:
            self._noted.begin({})
        self._socket = socket.create_server(("127.0.0.1", port))
        self.port = self._socket.getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}/?token={TOKEN}"
        title = "HITL-AC, seed 0"
        options = PageOptions(mode, title, asks, answer_seconds, silence_seconds, guide)
        said = journal.kinds(journal.read(path)[1])
        page = PageServer(PacedSession(session, self._noted, options, said), TOKEN, path)
        self._server = page.server()
        serve = functools.partial(page.serve, self._server, self._socket)
        self._thread = threading.Thread(target=lambda: asyncio.run(serve()))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._server.should_exit = True
        self._thread.join()
        self._noted.close()

    def said(self):
        """What the journal has of the person."""
        return [line["said"] for line in journal.read(self.path)[1] if "said" in line]

    def page(self, path, **headers):
        """(status, body) of a page."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", headers=headers)
        try:
            with urllib.request.urlopen(request) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def open(self, token=TOKEN, origin="", host=None):
        """A page's socket; with a host, as through a tunnel from there.

        Args:
            token: of the address.
            origin: of the page; by default the host, and None is a program that is no page.
            host: that the request names.
        """
        host = host or f"127.0.0.1:{self.port}"
        return connect(
            f"ws://{host}/socket?token={token}",
            origin=f"http://{host}" if origin == "" else origin,
            sock=socket.create_connection(("127.0.0.1", self.port)),
        )

    def answer(self, *lines):
        """What the server answers to the lines of a request: its status, and the last line."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=20) as one:
            one.sendall("\r\n".join([*lines, "Connection: close", "", ""]).encode("latin-1"))
            told = b"".join(iter(lambda: one.recv(4096), b"")).decode()
        return int(told.split()[1]), told.splitlines()[-1]


def until_update(page, kind, true=lambda update: True, seconds=20):
    """The first update of a type for which something is true; answers frames meanwhile."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        update = json.loads(page.recv(timeout=seconds))
        if update["type"] == "frame":
            say(page, "seen", frame=update["n"])
        if update["type"] == kind and true(update):
            return update
    raise TimeoutError(kind)


def say(page, kind, **fields):
    """Sends a message of a person."""
    page.send(json.dumps({"type": kind, **fields}))


def flood(page, message):
    """Sends a message 2000 times, or until the server closes the socket."""
    with contextlib.suppress(ConnectionClosed):
        for _ in range(2000):
            page.send(message)


def why_closed(page):
    """The code and reason with which the server closes a page's socket."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            page.recv(timeout=20)
    return page.close_code, page.close_reason


def play(session, until):
    """Ticks up to a frame."""
    while session.frame.number < until:
        session.tick()


def stored(session):
    """All that the learner has, and what the session says is there."""
    booked, learned = session.stored()
    np.testing.assert_array_equal(booked, learned)
    return learned
