"""How long shown frames wait for an answer."""

import pytest

from hitl_jax.live.silence_timer import SilenceTimer


def test_answers_are_of_frames_that_were_shown_in_any_order():
    one = SilenceTimer(1.0)
    one.start(10)
    one.show(10)
    with pytest.raises(ValueError, match=r"^seen: frame 11: must be from 0 to 10$"):
        one.answer(11)
    with pytest.raises(ValueError, match=r"^seen: frame -1: must be from 0 to 10$"):
        one.answer(-1)
    assert one.seen == 9
    one.show(20)
    one.answer(18)
    one.answer(12)  # It was overtaken.
    one.answer(0)  # Of a frame before the page came, which it has from somebody's time before.
    assert one.seen == 18
    assert [one.advance(1 / 16) for _ in range(20)] == [False] * 15 + [True] + [False] * 4
    one.hear(25)  # A judgement that names a frame that was not shown.
    assert one.seen == 20
    assert not any(one.advance(0.1) for _ in range(100))  # All was answered.
    one.show(21)
    one.hear(None)
    assert one.seen == 20
    assert not one.advance(60.0)
