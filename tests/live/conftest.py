"""Fixtures: a session that is served, sessions in simulated time, and a browser."""

import pytest
from live_team import Served, setup_of
from simulated_page import simulate

from hitl_jax.live.session import Session


@pytest.fixture
def served(tmp_path):
    """A session that is served in a thread."""
    with Served(Session(setup_of()), tmp_path / "journal.jsonl") as one:
        yield one


@pytest.fixture
def live(tmp_path, monkeypatch):
    """Runs a session in simulated time, see `simulate`."""

    def run(happens, setup=None, asks=False, mode="train"):
        return simulate(happens, tmp_path / "journal.jsonl", monkeypatch, setup, asks, mode)

    return run


@pytest.fixture(scope="module")
def browser():
    """Chromium; tests are skipped where there is none."""
    from browser_page import launched

    with launched() as one:
        yield one


@pytest.fixture
def page(browser):
    """A window of it."""
    from browser_page import window

    with window(browser) as one:
        yield one
