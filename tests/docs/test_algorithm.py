"""Every line and equation of the paper that the code cites stands in docs/algorithm.md."""

import re

from pages import ROOT, headings

_LINES = re.compile(r"\b[Ll]ines? (\d+(?:(?:, | and | to )\d+)*)\b")
_EQUATIONS = re.compile(r"\bequation \((\d)\)")


def _numbers(cited):
    """The lines that "2 and 10 to 12" names."""
    for part in re.split(", | and ", cited):
        first, *last = map(int, part.split(" to "))
        yield from range(first, (last or [first])[0] + 1)


def test_what_the_code_cites_is_explained():
    code = "\n".join(path.read_text() for path in sorted((ROOT / "hitl_jax").rglob("*.py")))
    lines = {line for cited in _LINES.findall(code) for line in _numbers(cited)}
    assert {2, 6, 7, 8, 9, 10, 11, 12} <= lines
    explained = set(headings("docs/algorithm.md"))
    # The heads and ends of loops share a paragraph.
    assert {f"Line {line}" for line in lines - {3, 5, 13, 14}} <= explained
    assert {f"Equation ({number})" for number in _EQUATIONS.findall(code)} <= explained
