"""The traced parameters of a simulated human."""

from flax import struct

from hitl_jax.choices.checks import MOST, require_whole
from hitl_jax.choices.fields import described, nested, number, require_fields, whole
from hitl_jax.choices.options import require_names

MAX_DELAY = 32
"""Longest reaction delay unless another is asked for, in steps."""

UNLIMITED = MOST
"""A budget of interventions that no run uses up."""


@described
@struct.dataclass
class HumanParams:
    """Traced parameters of a simulated human; each a scalar, or [R] for a batch of runs.

    Attributes:
        tolerance: hull angle from which a state is dangerous.
        horizon: how far ahead a `predictive` human looks.
        delay: reaction delay; 50 steps are one second, a person needs 10 to 25.
        mistake_rate: ε, probability that a judgement is flipped, at each step.
        lapse_rate: m, probability that no judgement is made, at each step.
        max_interventions: interventions that the human has patience for in a run. A judgement that
            is withheld counts as safe, and so loosens a boundary that raises alarms.
        refractory_steps: rest after an intervention before the next.
        extra: numbers of a part or danger model of one's own, by name.
    """

    tolerance: float = number(0.45, above=0.0, unit="rad")
    horizon: float = number(0.2, at_least=0.0, unit="s")
    delay: int = whole(0, unit="steps")
    mistake_rate: float = number(0.0, at_least=0.0, at_most=1.0, unit="1")
    lapse_rate: float = number(0.0, at_least=0.0, at_most=1.0, unit="1")
    max_interventions: int = whole(UNLIMITED, unit="count")
    refractory_steps: int = whole(0, unit="steps")
    extra: dict[str, float] = nested(dict, require_names)


def validate_human_params(
    params: HumanParams, max_delay: int = MAX_DELAY, prefix: str = "human."
) -> None:
    """Checks host values before any work starts.

    Args:
        params: scalars, not yet on a device.
        max_delay: longest delay that the human was made for [steps].
        prefix: before the names in messages.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    require_fields(params, prefix)
    require_whole(f"{prefix}delay", params.delay, at_most=max_delay)
