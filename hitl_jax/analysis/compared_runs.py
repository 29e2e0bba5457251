"""The runs that claims are judged on."""

from typing import NamedTuple

import numpy as np

from hitl_jax.analysis import stats
from hitl_jax.analysis.summary import SkillOverTraining, skill_over_training, was_tested
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import Run


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

    def tested(self) -> dict[str, SkillOverTraining] | None:
        """The autonomous tests of each method, at the same points; None where a run has none."""
        runs = [run for method in METHODS for run in self.runs[method]]
        if not all(map(was_tested, runs)):
            return None
        skill = skill_over_training(runs)
        parts = zip(METHODS, np.split(skill.returns, len(METHODS)), strict=True)
        return {method: skill._replace(returns=returns) for method, returns in parts}
