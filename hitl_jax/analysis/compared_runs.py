"""The runs that claims are judged on."""

from typing import NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.summary import skill_over_training, was_tested
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import Run


class TestedDuringTraining(NamedTuple):
    """Mean autonomous test returns at the same points of training of all runs, the end last.

    Attributes:
        points: training episodes until then, [P].
        returns: of each method, [S, P].
        episodes: of each test.
    """

    points: np.ndarray
    returns: dict[str, np.ndarray]
    episodes: int


class ComparedRuns(NamedTuple):
    """The runs of one learner, the same seeds of each method in the same order.

    Attributes:
        runs: finished runs by method.
        tolerance: hull angle from which the human sees danger [rad]; None where it is no angle.
        bounds: of the boundary, low and high.
    """

    runs: dict[str, list[Run]]
    tolerance: float | None
    bounds: tuple[float, float]

    @property
    def seeds(self) -> int:
        """S."""
        return len(self.runs[METHODS[0]])

    def resampled(self) -> np.ndarray:
        """Indices of seeds drawn with replacement, the same for all methods, [resamples, S]."""
        return stats.resampled_seeds(self.seeds)

    def tested(self) -> TestedDuringTraining | None:
        """The tests during training; None where a run has none."""
        runs = [run for method in METHODS for run in self.runs[method]]
        if not all(map(was_tested, runs)):
            return None
        skill = skill_over_training(runs)
        returns = np.split(skill.returns, len(METHODS))
        by_method = dict(zip(METHODS, returns, strict=True))
        return TestedDuringTraining(skill.points, by_method, skill.episodes)
