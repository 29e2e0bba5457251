"""Whether saved results can be had again: `hitl-jax verify RESULTS`.

Plays a sample of the runs: their recorded training episodes from the actions, their test episodes
from the parameters, each from its reset seed, and compares what the environment gives with what
the results say. Where they were made with other versions, or on another processor, it says so
first: rounding can differ then, and a walker's fate with it.
"""

import dataclasses
import pathlib
import random

import tyro

from hitl_jax.choices.checks import require
from hitl_jax.console.cli import checking_input, refusing
from hitl_jax.console.output import say
from hitl_jax.errors import ResultsError
from hitl_jax.playback.episodes import differences, require_repeatable
from hitl_jax.playback.load_trained import agent_of, require_same_human
from hitl_jax.playback.play_again import Pairs, play_again
from hitl_jax.results.folder import ResultsFolder
from hitl_jax.results.run_key import sort_keys
from hitl_jax.sweep.compile_cache import keep_programs

_SHOWN = 5


@dataclasses.dataclass(frozen=True)
class VerifyOptions:
    """Plays saved episodes again and compares their returns with the recorded ones.

    Attributes:
        results: a folder that a sweep has written.
        runs: number of runs to play, drawn at random; more than there are is all of them.
        sample: what the draw starts from.
        human_policy: the file given to the sweep under this name, if there was one.
    """

    results: tyro.conf.Positional[pathlib.Path]
    runs: int = 3
    sample: int = 0
    human_policy: str | None = None


def main(options: VerifyOptions) -> int:
    """Plays and compares.

    Args:
        options: what to play.

    Returns:
        The exit code: 0 if all agreed, else 1.

    Raises:
        BadInput: where there is nothing to play.
    """
    with checking_input():
        require("runs", options.runs, at_least=1)
        folder = ResultsFolder(options.results)
        require_repeatable(folder)
        require_same_human(folder, options.human_policy)
        agent = agent_of(folder, options.human_policy)
    with refusing():
        keys = sort_keys(folder.finished())
        if not keys:
            raise ResultsError(f"{options.results}: no run has finished yet")
        drawn = random.Random(options.sample).sample(keys, min(options.runs, len(keys)))
        chosen = sort_keys(set(drawn))
        if line := differences(folder, chosen):
            say(line)
        keep_programs()
        pairs: Pairs = []
        for key in chosen:
            played = play_again(agent, folder, key)
            _tell(str(key), played)
            pairs += [pair for of_phase in played.values() for pair in of_phase]
    print(f"{_agreed(pairs)} of {len(pairs)} episodes of {len(chosen)} of {len(keys)} runs agree")
    return 0 if _agreed(pairs) == len(pairs) else 1


def _tell(key: str, played: dict[str, Pairs]) -> None:
    """Says how many episodes of a run agree, and which do not."""
    parts = [f"{mode} {_agreed(pairs)} of {len(pairs)}" for mode, pairs in played.items()]
    say(f"{key}: {', '.join(parts)}")
    every = [pair for pairs in played.values() for pair in pairs]
    for recorded, now in [pair for pair in every if pair[0] != pair[1]][:_SHOWN]:
        print(f"  recorded {recorded:.3f}, now {now:.3f}")


def _agreed(pairs: Pairs) -> int:
    return sum(recorded == now for recorded, now in pairs)
