"""The paper's claims, one by one, against a folder of results."""

from collections.abc import Callable

from hitl_jax.analysis import (
    claims_for_human_time,
    claims_on_skill,
    claims_on_training,
    claims_over_steps,
)
from hitl_jax.analysis.compared_runs import ComparedRuns
from hitl_jax.analysis.verdicts import Claim
from hitl_jax.results.episode_tables import METHODS
from hitl_jax.results.folder import Run

MIN_SEEDS = 5
"""With fewer an interval is too narrow to decide anything."""

_CLAIMS: tuple[Callable[[ComparedRuns], Claim | None], ...] = (
    claims_on_training.speed,
    claims_on_training.speed_in_steps,
    claims_over_steps.area,
    claims_over_steps.seeds_needed,
    claims_over_steps.steps_until_tested,
    claims_over_steps.falls,
    claims_for_human_time.return_for_human_time,
    claims_on_skill.skill,
    claims_on_skill.skill_over_training,
    claims_on_skill.improvement,
    claims_on_training.boundary,
    claims_on_training.interventions,
    claims_on_skill.skill_with_help,
    claims_on_skill.assistance,
    claims_on_skill.assistance_during_training,
    claims_on_skill.alarms,
)


def judge(
    runs: dict[str, list[Run]], tolerance: float | None, bounds: tuple[float, float]
) -> list[Claim]:
    """All claims that a folder with the three methods can answer.

    Only seeds count that all three methods have finished.

    Args:
        runs: finished runs by method.
        tolerance: hull angle from which the human sees danger [rad]; None where it is no angle.
        bounds: of the boundary, low and high.

    Raises:
        ValueError: if there are fewer than `MIN_SEEDS` such seeds.
    """
    by_seed = [{run.key.seed: run for run in runs.get(method, [])} for method in METHODS]
    common = sorted(set.intersection(*map(set, by_seed)))
    if len(common) < MIN_SEEDS:
        raise ValueError(f"{len(common)} seeds done in all methods, of at least {MIN_SEEDS}")
    compared = [[of[seed] for seed in common] for of in by_seed]
    results = ComparedRuns(dict(zip(METHODS, compared, strict=True)), tolerance, bounds)
    return [claim for judged in _CLAIMS if (claim := judged(results)) is not None]
