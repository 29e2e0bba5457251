"""Tables in Markdown."""

from collections.abc import Sequence


def table_line(cells: Sequence[str]) -> str:
    """A line of a table; what a cell says is shown as it is, a "|" or a line's end in it too."""
    shown = (" ".join(cell.splitlines()).replace("|", r"\|") for cell in cells)
    return f"| {' | '.join(shown)} |"


def table(lines: Sequence[Sequence[str]]) -> str:
    """A table whose first line is its head."""
    head, *others = lines
    return "".join(f"{table_line(cells)}\n" for cells in (head, ["---"] * len(head), *others))
