"""Draws a results folder's figures: `python -m experiments.figures RESULTS`."""

import dataclasses
import pathlib
import sys

import numpy as np
import tyro

from hitl_jax.figures import draw_all
from hitl_jax.results import ResultsError, ResultsFolder

_BOOTSTRAP_SEED = 0
"""Fixed, so that the same results give the same bands."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Draws the figures of a results folder into its `figures/`, early data included.

    Attributes:
        results: the folder that a sweep has written, finished or under way.
    """

    results: tyro.conf.Positional[pathlib.Path]


def main(arguments: list[str] | None = None) -> int:
    """Draws, and prints the files written.

    Args:
        arguments: the command line without the program; None takes the process's own.

    Returns:
        The exit code: 0, or 2 with one line on stderr where there is nothing to draw from.
    """
    options = tyro.cli(Options, prog="python -m experiments.figures", args=arguments)
    try:
        paths, notes = draw_all(
            ResultsFolder(options.results), np.random.default_rng(_BOOTSTRAP_SEED)
        )
        if not paths:
            raise ResultsError(f"{options.results}: no episode has been saved yet")
    except ResultsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for line in [*notes, *paths]:
        print(line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
