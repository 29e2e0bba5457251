"""Draws a results folder's figures: `hitl-jax figures RESULTS`."""

import dataclasses
import pathlib

import tyro

from hitl_jax.analysis import diagnostic_figure
from hitl_jax.analysis.figures import draw_all
from hitl_jax.console.cli import BadInput, print_drawn, refusing
from hitl_jax.results.atomic_files import remove_leftovers
from hitl_jax.results.folder import ResultsFolder


@dataclasses.dataclass(frozen=True)
class Options:
    """Draws the figures of a results folder into its `figures/`, early data included.

    Attributes:
        results: the folder that a sweep has written, finished or under way.
        diagnostics: whether to draw `figure10_diagnostics` as well: losses, values and gradients
            of the learners, of finished runs.
    """

    results: tyro.conf.Positional[pathlib.Path]
    diagnostics: bool = False


def main(options: Options) -> int:
    """Draws, and prints the files written.

    Args:
        options: what to draw.

    Returns:
        The exit code: 0, or 1 if a figure could not be drawn.

    Raises:
        BadInput: where there is nothing to draw from.
    """
    folder = ResultsFolder(options.results)
    remove_leftovers(options.results / "figures")  # Of a drawing that was killed.
    with refusing():
        drawn = draw_all(folder)
        if options.diagnostics:
            drawn = drawn.with_(diagnostic_figure.draw(folder))
    if not drawn.paths and not drawn.failures:
        raise BadInput(f"{options.results}: no episode has been saved yet")
    return print_drawn(drawn)
