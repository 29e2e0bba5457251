"""Every line and equation of the paper that the code cites stands in docs/algorithm.md."""

import re

from pages import ROOT, headings

_LINES = re.compile(r"\b[Ll]ines? (\d+)(?: (?:and|to) (\d+))?\b")
_EQUATIONS = re.compile(r"\bequation \((\d)\)")


def test_what_the_code_cites_is_explained():
    code = "\n".join(path.read_text() for path in sorted((ROOT / "hitl_jax").rglob("*.py")))
    lines = {
        line
        for first, last in _LINES.findall(code)
        for line in range(int(first), int(last or first) + 1)
    }
    assert {2, 6, 7, 8, 9, 10, 11, 12} <= lines
    explained = set(headings("docs/algorithm.md"))
    missing = {f"Line {line}" for line in lines} - explained - {"Line 5"}
    assert not missing  # The heads and ends of loops share a paragraph.
    assert {f"Equation ({number})" for number in _EQUATIONS.findall(code)} <= explained
