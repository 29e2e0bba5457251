"""The live page in a browser: what a person does there with keys and clicks, and what it does."""

import re

import pytest
from browser_page import (
    PATIENCE,
    comes_to_frame,
    drawn_frame,
    expect,
    open_page,
    said_of,
    session_of,
    shows,
    wait_until,
)
from live_team import HYPER, Served

from hitl_jax.evaluation.trials import frozen


@pytest.fixture
def served(tmp_path):
    """A session in which no alarm is raised."""
    with Served(session_of(), tmp_path / "journal.jsonl") as one:
        yield one


def test_the_page_shows_the_walker(page, served):
    told = []
    page.on("console", lambda message: told.append(message.text))
    open_page(page, served)
    shows(page, "title", "HITL-AC, seed 0")
    shows(page, "mode", "training")
    shows(page, "role", "controller")
    shows(page, "control", "machine")
    shows(page, "gauge-name", "hull angle")
    shows(page, "boundary", "±1.500 rad")
    comes_to_frame(page, 20)
    expect(page.locator("#request")).to_be_hidden()
    expect(page.locator("#take")).to_be_enabled()
    expect(page.locator("#hip1-plus")).to_be_disabled()
    assert told == []  # Nothing was refused by the page's own policy, nothing was missing.


def test_danger_lasts_as_long_as_its_key(page, served):
    open_page(page, served)
    page.keyboard.down("d")
    shows(page, "judgement", "danger")
    began = drawn_frame(page)
    comes_to_frame(page, began + 3)
    page.keyboard.up("d")
    shows(page, "judgement", "safe")
    [down, up] = said_of(served, "danger")
    assert (down["down"], up["down"]) == (True, False)
    [label] = served.session.labels
    assert (label.kind, label.first, label.last) == ("danger", down["frame"], up["frame"])
    assert label.first <= began < label.last
    page.locator("#safe").click()
    shows(page, "labels", "2")
    [safe] = said_of(served, "safe")
    assert safe["frame"] > label.last


def test_a_hold_ends_where_the_window_is_left(page, served):
    open_page(page, served)
    page.locator("#danger").hover()
    page.mouse.down()
    shows(page, "judgement", "danger")
    page.evaluate("window.dispatchEvent(new Event('blur'))")
    shows(page, "judgement", "safe")
    page.mouse.up()
    page.keyboard.press("s")
    shows(page, "labels", "2")
    assert [said["down"] for said in said_of(served, "danger")] == [True, False]


def test_the_last_label_is_taken_back(page, served):
    open_page(page, served)
    page.keyboard.press("d")
    shows(page, "labels", "1")
    page.locator("#safe").click()
    shows(page, "labels", "2")
    page.keyboard.press("Backspace")
    shows(page, "labels", "1")
    page.locator("#undo").click()
    shows(page, "labels", "0")
    assert served.session.labels == []
    assert [said["type"] for said in served.said()][-2:] == ["undo", "undo"]


def test_a_person_takes_over_moves_and_lets_go(page, served):
    open_page(page, served)
    page.keyboard.press("t")
    shows(page, "control", "person")
    shows(page, "take-text", "Let go")
    page.keyboard.down("q")
    wait_until(page, lambda: len(said_of(served, "hands")) == 2)
    first = served.session.frame.number
    comes_to_frame(page, first + 3)
    stop = served.session.frame.number
    page.keyboard.up("q")
    wait_until(page, lambda: len(said_of(served, "hands")) == 3)
    page.keyboard.press("t")
    shows(page, "control", "machine")
    shows(page, "take-text", "Take over")
    expect(page.locator("#hip1-plus")).to_be_disabled()
    still, forward = [0, 0, 0, 0], [1, 0, 0, 0]
    assert [said["action"] for said in said_of(served, "hands")] == [still, forward, still]
    walked = served.session.actions(first, stop).tolist()
    assert forward in walked
    assert all(action in (forward, still) for action in walked)  # Zeros are of a reset.
    [take, let_go] = said_of(served, "take", "let_go")
    [label] = served.session.labels
    assert (label.kind, label.first) == ("take", take["frame"])
    assert label.last == let_go["frame"] - 1


def test_the_assistant_walks_while_its_key_is_held(page, served):
    open_page(page, served)
    page.locator("#take").click()
    shows(page, "control", "person")
    page.keyboard.down("g")
    wait_until(page, lambda: len(said_of(served, "assist")) == 1)
    first = served.session.frame.number
    comes_to_frame(page, first + 3)
    assert served.session.actions(first, first + 3).any()
    page.keyboard.up("g")
    wait_until(page, lambda: len(said_of(served, "assist")) == 2)
    assert [said["on"] for said in said_of(served, "assist")] == [True, False]


def test_the_clock_stops_and_goes_by_single_steps(page, served):
    open_page(page, served)
    expect(page.locator("#step")).to_be_disabled()
    page.keyboard.press("Space")
    page.wait_for_selector('[data-paused="true"]')
    shows(page, "running", "paused")
    held = served.session.frame.number
    page.keyboard.press("ArrowRight")
    page.wait_for_selector(f'[data-frame="{held + 1}"]')
    page.locator("#step").click()
    page.wait_for_selector(f'[data-frame="{held + 2}"]')
    assert served.session.frame.number == held + 2
    page.locator("#pause").click()
    page.wait_for_selector('[data-paused="false"]')
    comes_to_frame(page, held + 5)
    # Twice at once is on and off again, though the server has not answered in between.
    page.keyboard.press("Space")
    page.keyboard.press("Space")
    wait_until(page, lambda: len(said_of(served, "pause")) == 4)
    assert [said["on"] for said in said_of(served, "pause")] == [True, False, True, False]


def test_the_clock_goes_faster_and_slower(page, served):
    open_page(page, served)
    # Presses that follow at once count from each other, not from what the server told last.
    for key in ("+", "+", "+", "+"):
        page.keyboard.press(key)
    wait_until(page, lambda: len(said_of(served, "speed")) == 4)
    shows(page, "speed", "max")
    expect(page.locator("#chart-return")).to_have_attribute("aria-label", re.compile("Episode "))
    for _ in range(5):
        page.locator("#slower").click()
    wait_until(page, lambda: len(said_of(served, "speed")) == 9)
    shows(page, "speed", "1/2 ×")
    factors = [said["factor"] for said in said_of(served, "speed")]
    assert factors == [2, 4, 8, None, 8, 4, 2, 1, 0.5]
    # "+" as it is on many keyboards, and Shift let go first, when the same key is called "=".
    for _ in range(2):
        page.keyboard.down("Shift")
        page.keyboard.down("Equal")
        page.keyboard.up("Shift")
        page.keyboard.up("Equal")
    wait_until(page, lambda: len(said_of(served, "speed")) == 11)
    shows(page, "speed", "2 ×")


def test_a_second_window_watches(browser, page, served):
    open_page(page, served)
    other = browser.new_page()
    other.set_default_timeout(PATIENCE)
    open_page(other, served)
    shows(other, "role", "watcher")
    expect(other.locator("#danger")).to_be_disabled()
    expect(other.locator("#danger")).to_have_attribute("title", re.compile("only watches"))
    shows(page, "watchers", "1")
    other.keyboard.press("d")
    other.close()
    shows(page, "watchers", "0")
    assert served.said() == []


def test_the_page_finds_a_server_that_was_started_again(page, tmp_path):
    session, path = session_of(), tmp_path / "journal.jsonl"
    with Served(session, path) as served:
        open_page(page, served)
        page.keyboard.press("t")
        shows(page, "control", "person")
    page.wait_for_selector('[data-connection="reconnecting"]')
    expect(page.locator("#message")).to_contain_text("The connection was lost")
    expect(page.locator("#danger")).to_be_disabled()
    held = session.frame.number
    with Served(session, path, port=served.port) as again:
        page.wait_for_selector('[data-connection="connected"]')
        expect(page.locator("#message")).to_be_hidden()
        shows(page, "control", "machine")  # A page that was lost lets go.
        comes_to_frame(page, held + 5)
        page.keyboard.press("d")
        wait_until(page, lambda: len(said_of(again, "danger")) == 2)
        shows(page, "labels", "2")
        assert session.labels[-1].first > held
        kinds = [said["type"] for said in said_of(again, "take", "gone", "danger")]
        assert kinds == ["take", "gone", "danger", "danger"]


def test_a_page_that_stands_still_lets_go_and_says_why_it_paused(page, tmp_path):
    session = session_of()
    with Served(session, tmp_path / "journal.jsonl", silence_seconds=2.0) as served:
        open_page(page, served)
        page.keyboard.press("t")
        shows(page, "control", "person")
        page.keyboard.down("d")
        page.evaluate("const end = performance.now() + 4000; while (performance.now() < end);")
        expect(page.locator("#why-paused")).to_contain_text("did not answer for 2 s")
        expect(page.locator("#why-paused")).to_contain_text("Nobody judged frames")
        shows(page, "running", "paused")
        shows(page, "control", "machine")
        shows(page, "judgement", "safe")
        # The key is still down, but counts no more.
        expect(page.locator("#danger")).not_to_have_class(re.compile("held"))
        assert not session.person.dangerous
        [gone] = said_of(served, "gone")
        stopped = session.frame.number
        assert gone["frame"] < stopped
        page.keyboard.up("d")
        page.keyboard.press("Space")
        expect(page.locator("#why-paused")).to_be_hidden()
        comes_to_frame(page, stopped + 5)
        page.keyboard.press("d")
        shows(page, "labels", "2")
        assert [said["down"] for said in said_of(served, "danger")][-2:] == [True, False]


def _asked(page, session):
    """Waits until the walker asks, and the page has drawn the frame; its number."""
    expect(page.locator("#request")).to_be_visible()
    wait_until(page, lambda: drawn_frame(page) == session.frame.number)
    assert session.frame.alarmed
    return session.frame.number


def test_the_walker_asks_and_is_answered_or_goes_on(page, tmp_path):
    session = session_of(frozen(HYPER, human_present=True))
    path = tmp_path / "journal.jsonl"
    with Served(session, path, mode="test", asks=True, answer_seconds=60) as served:
        open_page(page, served)
        shows(page, "mode", "test")
        page.keyboard.press("+")
        page.keyboard.press("+")
        number = _asked(page, session)
        shows(page, "alarm", "yes")
        shows(page, "running", "waiting")
        expect(page.locator("#request-left")).to_have_text(re.compile(r"^[0-5]?\d\.\d$"))
        expect(page.locator("#request-default")).to_contain_text("Without an answer")
        page.keyboard.press("d")
        shows(page, "control", "person")  # An alarm that is one hands the controls over.
        said, control = session.labels
        assert (said.kind, said.first) == ("danger", number)
        assert (control.kind, control.first, control.cause) == ("take", number, said.number)
        shows(page, "labels", "1")
        page.keyboard.press("t")
        number = _asked(page, session)
        page.locator("#request-safe").click()
        wait_until(page, lambda: {"type": "safe", "frame": number} in served.said())
        assert (session.labels[-1].kind, session.labels[-1].first) == ("safe", number)
    with Served(session, path, mode="test", asks=True, port=served.port) as again:
        page.wait_for_selector('[data-connection="connected"]')
        wait_until(page, lambda: said_of(again, "no_answer"))
        # Nobody's word is no label of theirs.
        assert len([label for label in session.labels if label.kind != "nobody"]) == 3
        comes_to_frame(page, said_of(again, "no_answer")[0]["frame"])


def test_where_a_simulated_human_judges_only_the_clock_is_the_persons(page, tmp_path):
    session = session_of(with_person=False)
    with Served(session, tmp_path / "journal.jsonl", mode="watch") as served:
        open_page(page, served)
        shows(page, "mode", "watching")
        for name in ("danger", "take", "hip1-plus", "reaction"):
            expect(page.locator(f"#{name}")).to_be_hidden()
        page.keyboard.press("d")
        page.keyboard.press("Space")
        page.wait_for_selector('[data-paused="true"]')
        assert [said["type"] for said in served.said()] == ["pause"]
