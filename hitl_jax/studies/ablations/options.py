"""The options of an ablation."""

import dataclasses
from typing import Annotated

import tyro

from hitl_jax.choices.checks import one_of, require_seeds, require_whole
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES
from hitl_jax.studies.ablations.settings import ABLATIONS, Ablation, Budget
from hitl_jax.sweep.launchers import LaunchOptions


@dataclasses.dataclass(frozen=True)
class AblationOptions:
    """Compare settings of one part of the team, each over several seeds.

    Attributes:
        name: one of exploration, fading, loophole, boundary-parts, initial-boundary, human-price,
            human-data; or `all`.
        seeds: number of seeds for each setting (default of this and of the next three options:
            what the ablation's kept table has).
        first_seed: the first of them.
        episodes: training episodes of a run.
        test_episodes: test episodes of a run, alone and again with the human.
        out: folder of the results: `runs.csv`, and a table and a figure for each ablation. An
            interrupted ablation goes on in the same folder where it was.
        launch: where runs are made.
    """

    name: tyro.conf.Positional[str]
    seeds: int | None = None
    first_seed: int | None = None
    episodes: int | None = None
    test_episodes: int | None = None
    out: str = "runs/ablations"
    launch: Annotated[LaunchOptions, tyro.conf.arg(name="")] = LaunchOptions()

    def chosen(self) -> dict[str, Ablation]:
        """The ablations that are asked for, each with its budget, but for what was asked for."""
        names = (field.name for field in dataclasses.fields(Budget))
        asked = {name: value for name in names if (value := getattr(self, name)) is not None}
        return {
            name: dataclasses.replace(one, budget=dataclasses.replace(one.budget, **asked))
            for name, one in ABLATIONS.items()
            if self.name in (name, "all")
        }

    def checked(self) -> "AblationOptions":
        """Checks every option; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        one_of("name", self.name, (*ABLATIONS, "all"))
        for budget in (ablation.budget for ablation in self.chosen().values()):
            require_seeds(budget.first_seed, budget.seeds)
            require_whole("episodes", budget.episodes, at_least=1)
            require_whole("test_episodes", budget.test_episodes, 1, MOST_TEST_EPISODES)
        self.launch.checked()
        return self
