"""What tests read of README.md, docs/ and other pages: headings, programs, tables."""

import os
import pathlib
import re

ROOT = pathlib.Path(__file__).parents[1]
PAGES = [
    *(
        ROOT / name
        for name in ("README.md", "SECURITY.md", "results/README.md", "results/REPORT.md")
    ),
    *sorted((ROOT / "docs").glob("*.md")),
]

_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)


def section(page, heading):
    """The text below a heading, up to the next heading of its level or above."""
    text = (ROOT / page).read_text()
    [begin] = re.finditer(rf"^(#+) {re.escape(heading)}$", text, flags=re.MULTILINE)
    rest = text[begin.end() :]
    # A line of a program may begin with a number sign too.
    prose = _FENCE.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), rest)
    end = re.search(rf"^#{{1,{len(begin[1])}}} ", prose, flags=re.MULTILINE)
    return rest[: end.start()] if end else rest


def headings(page):
    """All headings of a page."""
    text = _FENCE.sub("", (ROOT / page).read_text())
    return re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)


def anchor(heading):
    """What GitHub calls a heading in an address."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def python_in(text):
    """The Python programs in a text, one after the other."""
    return [code for language, code in _FENCE.findall(text) if language == "python"]


def run(code, folder):
    """Runs a program in a folder that has a link to `results`; what it defines."""
    link = folder / "results"
    if not link.exists():
        link.symlink_to(ROOT / "results")
    before = pathlib.Path.cwd()
    os.chdir(folder)
    try:
        names = {}
        exec(compile(code, "snippet", "exec"), names)
    finally:
        os.chdir(before)
    return names


def first_column(text):
    """The names in code style in the first cells of the tables of a text."""
    rows = re.findall(r"^\| ([^|]*) \|", text, flags=re.MULTILINE)
    return [name for cell in rows for name in re.findall(r"`([^`]+)`", cell)]
