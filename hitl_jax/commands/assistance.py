"""What a human's help is worth: `hitl-jax assistance RESULTS`.

Tests the trained walkers of HITL-FIX and HITL-AC once more, on the terrains of their tests: alone,
and with the human, who is called by the run's own boundary, by a fixed boundary, by the hull's
angle, and by chance, at several rates of alarms: the run's own human, who has to agree, and one who
trusts every alarm. So returns and falls are compared at equal shares of the steps in human hands.
"""

import dataclasses
import pathlib

import tyro

from hitl_jax.analysis import assistance_figure
from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input, print_drawn, refusing
from hitl_jax.console.output import say
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES
from hitl_jax.playback.assistance import SHARES, write_assistance
from hitl_jax.playback.load_trained import agent_of, require_same_human
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.sweep.compile_cache import keep_programs

_MOST_EPISODES = MOST_TEST_EPISODES // len(SHARES)
"""The examiner has a walker for each episode at each rate of alarms."""


@dataclasses.dataclass(frozen=True)
class AssistanceOptions:
    """Tests trained walkers with the human, at several rates of alarms.

    Writes RESULTS/assistance.csv and Figure 12.

    Attributes:
        results: a folder that a sweep has written.
        episodes: test episodes of a run, for each rule and rate of alarms.
        human_policy: the file given to the sweep under this name, if there was one.
    """

    results: tyro.conf.Positional[pathlib.Path]
    episodes: int = 30
    human_policy: str | None = None


def main(options: AssistanceOptions) -> int:
    """Plays, writes and draws.

    Args:
        options: what to play.

    Returns:
        The exit code: 0, or 1 if the figure could not be drawn.

    Raises:
        BadInput: where there is nothing to play.
    """
    with checking_input():
        require("episodes", options.episodes, at_least=1, at_most=_MOST_EPISODES)
    with refusing():
        folder = ResultsFolder(options.results)
        require_same_human(folder, options.human_policy)
        agent = agent_of(folder, options.human_policy)
        keep_programs()
        write_assistance(folder, agent, options.episodes, say)
        drawn = assistance_figure.draw(folder)
    return print_drawn(drawn)
