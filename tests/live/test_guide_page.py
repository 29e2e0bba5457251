"""The pages that lead a person through a session, in a browser."""

from browser_page import (
    comes_to_frame,
    expect,
    open_page,
    said_of,
    session_of,
    shows,
)
from live_team import Served

from hitl_jax.live.guide import GuideOptions


def _guide_shows(page, card):
    expect(page.locator(f'[data-card="{card}"]')).to_be_visible()


def test_the_page_leads_a_person_through_a_session(page, tmp_path):
    session = session_of()
    guide = GuideOptions("All keys are kept.", 30)
    with Served(session, tmp_path / "journal.jsonl", guide=guide) as served:
        open_page(page, served)
        _guide_shows(page, "consent")
        expect(page.locator("#consent-text")).to_have_text("All keys are kept.")
        expect(page.locator("#guide-next")).to_be_disabled()
        for key in ("Escape", "Escape", "Escape", "h", "d"):  # Nobody gets past it.
            page.keyboard.press(key)
        _guide_shows(page, "consent")
        page.locator("#agree").focus()
        page.keyboard.press("Space")  # Of the box, and not of the clock.
        for card, key in (("walker", "x"), ("danger", "d"), ("safe", "s"), ("take", "t")):
            page.locator("#guide-next").click()
            _guide_shows(page, card)
            page.keyboard.press(key)
            expect(page.locator(".done:visible")).to_have_count(int(key != "x"))
            expect(page.locator("#guide-alert")).to_be_hidden()
        page.locator("#guide-next").click()
        assert (session.frame.number, session.labels) == (0, [])
        page.locator("#guide-next").click()
        _guide_shows(page, "questions")
        expect(page.locator("#danger")).to_be_disabled()
        for key in ("Escape", "Escape", "h", *["Tab"] * 7):
            page.keyboard.press(key)
        expect(page.locator("#missing")).to_have_text("Not answered yet: 6")
        sliders = page.locator("#questions input")
        for number in range(6):
            expect(page.locator("#guide-next")).to_be_disabled()
            sliders.nth(number).focus()
            page.keyboard.press(("Home", "Enter", "ArrowRight")[min(number, 2)])
        page.locator("#guide-next").click()
        _guide_shows(page, "end")
        assert said_of(served, "questionnaire") == [
            {"type": "questionnaire", "answers": [0, 50, 55, 55, 55, 55]}
        ]
        with page.expect_download() as download:
            page.locator("#copy").click()
        assert download.value.suggested_filename == "session.jsonl"
        page.reload()
        _guide_shows(page, "end")


def test_what_to_do_is_shown_again_while_the_clock_stands(page, tmp_path):
    with Served(session_of(), tmp_path / "journal.jsonl") as served:
        open_page(page, served)
        comes_to_frame(page, 3)
        page.keyboard.press("h")
        _guide_shows(page, "walker")
        page.wait_for_selector('[data-paused="true"]')
        page.keyboard.press("d")
        page.keyboard.press("Escape")
        expect(page.locator("#guide")).to_be_hidden()
        page.wait_for_selector('[data-paused="false"]')
        expect(page.locator("#safe")).to_be_enabled()
        page.keyboard.press("s")
        shows(page, "labels", "1")
        assert [label.kind for label in served.session.labels] == ["safe"]
