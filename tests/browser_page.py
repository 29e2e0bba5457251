"""The live page in a browser, for tests: a window, and what they wait for there."""

import contextlib
import re
import shutil
import time

import pytest
from live_team import HYPER, setup_of

from hitl_jax.live.session import Session

playwright = pytest.importorskip(
    "playwright.sync_api", reason='there is no Playwright: pip install -e ".[browser]"'
)
expect = playwright.expect

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_BROWSER = next(filter(None, map(shutil.which, _BROWSERS)), None)
if _BROWSER is None:
    pytest.skip(f"there is no browser: none of {', '.join(_BROWSERS)}", allow_module_level=True)

NO_ALARM = HYPER.replace(initial_boundary=1.5, delta_minus=0.0)
PATIENCE = 30_000
"""Of what is waited for [ms]; nothing takes that long unless it fails."""


@contextlib.contextmanager
def launched():
    """A browser."""
    expect.set_options(timeout=PATIENCE)
    with playwright.sync_playwright() as tools:
        one = tools.chromium.launch(executable_path=_BROWSER, args=["--no-sandbox"])
        yield one
        one.close()


@contextlib.contextmanager
def window(browser):
    """A window; what goes wrong in its script fails the test."""
    one = browser.new_page(viewport={"width": 1280, "height": 720})
    one.set_default_timeout(PATIENCE)
    wrong = []
    one.on("pageerror", lambda error: wrong.append(str(error)))
    yield one
    one.close()
    assert wrong == []


def session_of(hyper=NO_ALARM, **changes):
    """One that does not learn, as the page only counts what is learned."""
    return Session(setup_of(hyper=hyper, learns=False, **changes))


def open_page(page, served):
    """Opens the page; it has drawn a frame then."""
    page.goto(served.address)
    shows(page, "connection", "connected")
    expect(page.locator("html")).to_have_attribute("data-frame", re.compile(r"\d"))


def shows(page, name, text):
    expect(page.locator(f"#{name}")).to_have_text(text)


def said_of(served, *kinds):
    """What the journal has of some types of messages."""
    return [said for said in served.said() if said["type"] in kinds]


def comes_to_frame(page, number):
    """Waits until the page has drawn a frame that comes after one."""
    wait_until(page, lambda: drawn_frame(page) > number)


def drawn_frame(page):
    """The number of the frame that the page has drawn last."""
    return int(page.locator("html").get_attribute("data-frame"))


def wait_until(page, true):
    """Waits until something is true of a page."""
    end = time.monotonic() + PATIENCE / 1000
    while not true():
        assert time.monotonic() < end
        page.wait_for_timeout(20)
