"""The options of an ablation."""

import dataclasses
from typing import Annotated

import tyro

from hitl_jax.choices.checks import require_seeds, require_whole
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES
from hitl_jax.sweep.launchers import LaunchOptions


@dataclasses.dataclass(frozen=True)
class AblationOptions:
    """Compare settings of one part of the team, each over several seeds.

    Attributes:
        name: one of exploration, fading, feedback, loophole, boundary-parts, boundary-start,
            initial-boundary, human-price, human-data; or `all`.
        seeds: number of seeds for each setting.
        first_seed: the first of them.
        episodes: training episodes of a run.
        test_episodes: test episodes of a run, alone and again with the human.
        out: folder of the results: `runs.csv`, and a table and a figure for each ablation. An
            interrupted ablation goes on in the same folder where it was.
        launch: where runs are made.
    """

    name: tyro.conf.Positional[str]
    seeds: int = 5
    first_seed: int = 0
    episodes: int = 300
    test_episodes: int = 20
    out: str = "runs/ablations"
    launch: Annotated[LaunchOptions, tyro.conf.arg(name="")] = LaunchOptions()

    @property
    def budget(self) -> dict[str, int]:
        """What must be equal for two runs to be compared."""
        return {"episodes": self.episodes, "test_episodes": self.test_episodes}

    def checked(self) -> "AblationOptions":
        """Checks all but the name; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        require_seeds(self.first_seed, self.seeds)
        require_whole("episodes", self.episodes, at_least=1)
        require_whole("test_episodes", self.test_episodes, 1, MOST_TEST_EPISODES)
        self.launch.checked()
        return self
