"""What a test waits for on the live page in a browser; `page` is Playwright's."""

import time

PATIENCE = 30_000
"""Of what is waited for [ms]; nothing takes that long unless it fails."""


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
