"""docs/architecture.md has every room, in the order in which they may import each other."""

import re

from pages import ROOT, first_column, section

import hitl_jax

PAGE = "docs/architecture.md"


def test_every_room_has_a_line():
    package = ROOT / "hitl_jax"
    rooms = {path.stem for path in package.iterdir() if not path.name.startswith("__")} - {"py"}
    named = first_column(section(PAGE, "The rooms"))
    assert set(named) == rooms and len(named) == len(rooms)


def test_the_lines_are_in_the_order_of_imports():
    above = []
    for room in first_column(section(PAGE, "The rooms")):
        above.append(room)
        path = ROOT / "hitl_jax" / room
        files = path.rglob("*.py") if path.is_dir() else [path.with_suffix(".py")]
        code = "\n".join(file.read_text() for file in files)
        found = re.findall(r"^\s*(?:from|import) hitl_jax\.(\w+)", code, flags=re.MULTILINE)
        found += re.findall(r"^\s*from hitl_jax import \(?([\w, ]+)", code, flags=re.MULTILINE)
        used = {name for names in found for name in re.findall(r"\w+", names)}
        used -= set(hitl_jax.__all__) | {"__main__", "as"}
        assert used <= set(above), room


def test_the_page_answers_what_is_asked_most():
    answers = section(PAGE, "Where things are") + section(PAGE, "What to open to add something")
    for asked in ("where an episode ends", "τ is clipped", "Figure 6", "dead worker", "SAC"):
        assert asked in answers
