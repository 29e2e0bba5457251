"""The intervals in results/README.md are those that the kept summaries have."""

import re

import pytest
from pages import ROOT, section

_ROW = re.compile(r"^\| ([^|]*\[95 %\][^|]*) \| (.*) \|$", flags=re.MULTILINE)
_KEPT = (
    "full",
    "steady_noise",
    "fading",
    "ten_seeds",
    "paper",
    "thousand",
    "lunar_lander",
    "one_hour",
    "one_hour_xeon",
    "one_hour_newest",
    "bfloat16",
)


@pytest.mark.parametrize("folder", [*_KEPT, "jax"])
def test_intervals_are_those_of_the_summaries(folder):
    summary = (ROOT / "results" / folder / "summary.md").read_text()
    rows = _ROW.findall(section("results/README.md", folder))
    assert rows
    for name, cells in rows:
        if "mean beside that" in name:  # Computed from several folders.
            continue
        elsewhere = "in Box2D" in name
        kept = (ROOT / "results/ten_seeds/summary.md").read_text() if elsewhere else summary
        for cell in cells.split(" | "):
            assert cell == "–" or f"| {cell} |".replace("−", "-") in kept, (name, cell)
