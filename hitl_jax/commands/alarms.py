"""How well alarms foretell falls: `hitl-jax alarms RESULTS`.

Plays the trained walkers of a results folder once more, alone, on the terrains of their tests (of
EnvPool's, which cannot be had again, on others), and counts for a range of boundaries what alarms
at |c_t| >= τ would have told: how often they come, how many are followed by a fall, how many falls
they announce, and how long before. It also compares indicators where they raise as many false
alarms, and a learned risk with what came. A pool of your own plays again where you trust its module
(`HITL_JAX_MODULES`).
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.analysis import alarm_figures, warning_figures
from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input, print_drawn, refusing
from hitl_jax.console.output import say
from hitl_jax.playback.alarm_counts import write_alarms
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep.compile_cache import keep_programs


@dataclasses.dataclass(frozen=True)
class AlarmOptions:
    """Counts alarms and falls of trained walkers.

    Writes RESULTS/alarms.csv and Figure 8; RESULTS/early_warnings.csv, precision.csv,
    reliability.csv and Figure 11.

    Attributes:
        results: a folder that a sweep has written.
        episodes: test episodes of a run.
    """

    results: tyro.conf.Positional[pathlib.Path]
    episodes: int = 100


def main(options: AlarmOptions) -> int:
    """Plays, writes and draws.

    Args:
        options: what to play.

    Returns:
        The exit code: 0, or 1 if the figure could not be drawn.

    Raises:
        BadInput: where there is nothing to play.
    """
    with checking_input():
        require("episodes", options.episodes, at_least=1)
    with refusing():
        folder = ResultsFolder(options.results)
        keep_programs()
        write_alarms(folder, options.episodes, say)
        drawn = alarm_figures.draw(folder).with_(warning_figures.draw(folder))
    return print_drawn(drawn)
