"""What a person reads: their own words as they wrote them, on any terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

_STRICT = ("strict", "surrogateescape")


def replace_what_cannot_be_encoded() -> None:
    """Makes standard output and error show "?" for what their encoding lacks.

    A terminal may know ASCII alone, and a folder's name may be no text at all; neither may end the
    work. A stream that cannot be told so, as a notebook's, stays as it is.
    """
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) in _STRICT and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def plain_console(width: int | None = None) -> Console:
    """A console for tables that shows text as it is: no "[red]" and no ":smile:" means anything.

    Args:
        width: in characters; None is the terminal's.
    """
    from rich.console import Console  # Not for `hitl-jax --help`: it takes time.

    return Console(width=width, markup=False, emoji=False, highlight=False)
