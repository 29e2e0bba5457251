"""The traced parameters of a simulated human."""

from typing import Any

from flax import struct

from hitl_jax.choices.checks import MOST, require_that, require_up_to
from hitl_jax.choices.fields import checked_by, described, nested, require_fields
from hitl_jax.choices.options import require_names

MAX_DELAY = 32
"""Longest reaction delay unless another is asked for, in steps."""

UNLIMITED = MOST
"""A budget of interventions that no run uses up."""


def _above_0(name: str, value: Any) -> None:
    require_that(name, value, lambda number: number > 0, "a finite number above 0")


def _at_least_0(name: str, value: Any) -> None:
    require_that(name, value, lambda number: number >= 0, "a finite number of at least 0")


def _share(name: str, value: Any) -> None:
    require_up_to(name, value, 1)


def _count(name: str, value: Any) -> None:
    require_up_to(name, value, UNLIMITED, whole=True)


@described
@struct.dataclass
class HumanParams:
    """Traced parameters of a simulated human; each a scalar, or [R] for a batch of runs.

    Attributes:
        tolerance: hull angle from which a state is dangerous.
        horizon: how far ahead a `predictive` human looks.
        delay: reaction delay; 50 steps are one second. A simple reaction to what is seen takes
            people 0.2 to 0.25 s, a choice more.
        mistake_rate: ε, probability that a judgement is flipped, at each step.
        lapse_rate: m, probability that no judgement is made, at each step.
        max_interventions: interventions that the human has patience for in a run. A judgement that
            is withheld counts as safe, and so loosens a boundary that raises alarms.
        refractory_steps: rest after an intervention before the next.
        extra: numbers of single parts and danger models, by name: `least_expectation` (0.05) of
            `experienced`, `foresight_margin` (3 m) of `foresight`, and those of one's own.
    """

    tolerance: float = checked_by(0.45, _above_0, "rad")
    horizon: float = checked_by(0.2, _at_least_0, "s")
    delay: int = checked_by(10, _count, "steps")
    mistake_rate: float = checked_by(0.0, _share, "1")
    lapse_rate: float = checked_by(0.0, _share, "1")
    max_interventions: int = checked_by(UNLIMITED, _count, "count")
    refractory_steps: int = checked_by(0, _count, "steps")
    extra: dict[str, float] = nested(dict, require_names)


def validate_human_params(params: HumanParams, max_delay: int = MAX_DELAY) -> None:
    """Checks host values before any work starts.

    Args:
        params: scalars, not yet on a device.
        max_delay: longest delay that the human was made for [steps].

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    require_up_to("human.delay", params.delay, max_delay, whole=True)
    require_fields(params, "human.")
