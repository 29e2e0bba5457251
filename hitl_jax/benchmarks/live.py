"""The live page: frames a second while the learner learns, and how soon a key is seen to act.

As a program at the page's socket sees it, and as headless Chromium draws it, where there is one.
"""

import contextlib
import itertools
import json
import pathlib
import re
import shutil
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from typing import Any

from hitl_jax.benchmarks.crowd import CROWD, crowd, seconds_of_page
from hitl_jax.envs.interpreter import child_interpreter
from hitl_jax.results.episode_measures import Row

FRAMES_BAR, LATENCY_BAR = 50, 60
PAGE_BAR, LOG_BAR = 2.0, 1000
"""Beside a crowd: a new page [s], and the log of a minute [kB]."""

_VISIT_EVERY = 0.5
_MINUTE_OF = 30.0
"""Stretches of `seconds` that are played: a minute, of the two seconds of the default."""
_KEYS = 40
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")

_WATCH = """() => {
  window.frames = []; window.acts = []; let pressed = 0;
  new MutationObserver(() => frames.push(performance.now()))
    .observe(document.documentElement, {attributeFilter: ["data-frame"]});
  window.addEventListener("keydown", () => { pressed = performance.now(); }, true);
  new MutationObserver(() => {
    if (pressed) { acts.push(performance.now() - pressed); pressed = 0; }
  }).observe(document.getElementById("control"), {attributeFilter: ["data-state"]});
}"""


def measure_live(seconds: float) -> list[Row]:
    """Plays a session of the default team at real time; the learner is at work.

    Args:
        seconds: of one of thirty stretches.
    """
    try:
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ImportError:
        return [{"seen by": 'missing: pip install -e ".[live]"'}]
    with _served() as (address, _):
        rows = [_by_socket(address, _MINUTE_OF * seconds)]
        rows.append(_by_chromium(address, _MINUTE_OF * seconds))
    with _served() as (address, log):
        rows.append(_beside_crowd(address, log, _MINUTE_OF * seconds))
    return rows


def _beside_crowd(address: str, log: pathlib.Path, seconds: float) -> Row:
    """Frames, new pages and log while a crowd of strangers holds connections."""
    pages: list[float] = []
    over = threading.Event()

    def visit() -> None:
        while not over.wait(_VISIT_EVERY):
            pages.append(seconds_of_page(address))

    visitor = threading.Thread(target=visit)
    with crowd(int(address.split("/")[2].rpartition(":")[2])):
        visitor.start()
        row = _by_socket(address, seconds)
        over.set()
        visitor.join()
    return row | {
        "seen by": f"the same, beside {CROWD:,} connections that never finish their request",
        "new pages": len(pages),
        "slowest page s": round(max(pages), 2),
        "bar s": PAGE_BAR,
        "log kB": round(log.stat().st_size / 1000, 1),
        "bar kB": LOG_BAR,
    }


@contextlib.contextmanager
def _served() -> Iterator[tuple[str, pathlib.Path]]:
    """The address of the page of a session that learns from its first seconds on, and its log."""
    with tempfile.TemporaryDirectory() as folder:
        python, environment = child_interpreter()
        command = [*python, "-m", "hitl_jax", "live", "--port", "0", "--no-open-page"]
        command += ["--warmup-steps", "64", "--journal", str(pathlib.Path(folder) / "session")]
        log = pathlib.Path(folder) / "log"
        with (
            open(log, "wb") as errors,
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, encoding="utf-8", env=environment
            ) as server,
        ):
            assert server.stdout is not None
            try:
                lines = (re.search(r"http://\S+", line) for line in server.stdout)
                yield next(found[0] for found in lines if found), log
            finally:
                server.terminate()
                server.communicate()


def _by_socket(address: str, seconds: float) -> Row:
    from websockets.sync.client import connect
    from websockets.typing import Origin

    host = address.split("/")[2]
    socket = connect(
        address.replace("http://", "ws://").replace("/?", "/socket?"),
        origin=Origin(f"http://{host}"),
    )
    with socket as page:

        def until(true: Any) -> dict[str, Any]:
            while True:
                message: dict[str, Any] = json.loads(page.recv(timeout=60))
                if message["type"] == "frame":
                    page.send(json.dumps({"type": "seen", "frame": message["n"]}))
                    if true(message):
                        return message

        number = until(lambda frame: frame["n"] > 100)["n"]
        times = []
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            until(lambda _: True)
            times.append(time.perf_counter())
        taken = []
        for turn in range(_KEYS):
            kind, control = ("let_go", "machine") if turn % 2 else ("take", "person")
            pressed = time.perf_counter()
            page.send(json.dumps({"type": kind, "frame": number}))
            number = until(lambda frame, control=control: frame["control"] == control)["n"]
            taken.append(1000 * (time.perf_counter() - pressed))
            for _ in range(3 + turn % 4):
                number = until(lambda _: True)["n"]
    return _row("a program at the socket", times, taken)


def _by_chromium(address: str, seconds: float) -> Row:
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return {"seen by": 'Chromium: missing: pip install -e ".[browser]"'}
    if browser is None:
        return {"seen by": f"Chromium: missing, none of {', '.join(_BROWSERS)}"}
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = started.new_page(viewport={"width": 1280, "height": 720})
        page.goto(address)
        page.wait_for_selector("html[data-connection=connected]")
        page.evaluate(_WATCH)
        page.wait_for_timeout(1000 * seconds)
        times = page.evaluate("frames.map(time => time / 1000)")
        for turn in range(_KEYS):
            page.keyboard.press("t")
            page.wait_for_selector(f"#control[data-state={'machine' if turn % 2 else 'person'}]")
            page.wait_for_timeout(450 + 7 * turn)  # The page takes a key's word for 400 ms.
        taken = page.evaluate("acts")
        started.close()
    return _row("Chromium, drawn", times, taken)


def _row(seen_by: str, times: list[float], taken: list[float]) -> Row:
    gaps = [1000 * (after - before) for before, after in itertools.pairwise(times)]
    seconds = [int(one - times[0]) for one in times]
    whole = [seconds.count(one) for one in range(seconds[-1])]
    return {
        "seen by": seen_by,
        "for s": round(times[-1] - times[0], 1),
        "frames/s": round((len(times) - 1) / (times[-1] - times[0]), 1),
        "bar": FRAMES_BAR,
        "least in a second": min(whole, default=0),
        "99 % of gaps below ms": round(statistics.quantiles(gaps, n=100)[-1], 1),
        "key to walker, median ms": round(statistics.median(taken), 1),
        "bar ms": LATENCY_BAR,
        "most ms": round(max(taken), 1),
    }
