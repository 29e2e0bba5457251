"""Where there is no terminal: lines that come soon, and then now and then."""

from hitl_jax.console import progress
from hitl_jax.console.progress import Progress


def test_lines_come_soon_and_then_every_half_minute(capsys, monkeypatch):
    said = []
    shown = Progress(["srl"], 1, 10, 0)
    for second in range(120):
        monkeypatch.setattr(progress.time, "monotonic", lambda now=1000.0 + second: now)
        shown.show([])
        if capsys.readouterr().out:
            said.append(second)
    assert said == [0, 5, 10, 20, 40, 70, 100]
