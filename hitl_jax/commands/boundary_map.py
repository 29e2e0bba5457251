"""The boundary as a function of the state: `hitl-jax boundary-map RESULTS`.

For results whose boundary an actor gives (`--boundary-source network` or `residual`). Plays
HITL-AC's trained walkers alone, and shows the mean boundary over hull angle and angular velocity
where they have been.
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.analysis import boundary_map
from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input, print_drawn, refusing
from hitl_jax.console.output import say
from hitl_jax.playback.boundary_visits import map_boundary
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep.compile_cache import keep_programs


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """Maps the boundary that an actor has learned; writes RESULTS/boundary_map.csv and figure 9.

    Attributes:
        results: a folder that a sweep has written, with `network` or `residual` as its source.
        episodes: test episodes of a run.
    """

    results: tyro.conf.Positional[pathlib.Path]
    episodes: int = 20


def main(options: MapOptions) -> int:
    """Plays, writes and draws.

    Args:
        options: what to play.

    Returns:
        The exit code: 0, or 1 if the figure could not be drawn.

    Raises:
        BadInput: where there is nothing to map.
    """
    with checking_input():
        require("episodes", options.episodes, at_least=1)
    with refusing():
        folder = ResultsFolder(options.results)
        keep_programs()
        map_boundary(folder, options.episodes, say)
        drawn = boundary_map.draw(folder)
    return print_drawn(drawn)
