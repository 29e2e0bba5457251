"""The boundary learners by name. To add one: implement `BoundaryLearner` and register it."""

from hitl_jax.boundary.learner import NEEDS, BoundaryLearner, Sizes
from hitl_jax.boundary.margin import MarginLearner
from hitl_jax.boundary.printed import PrintedLearner
from hitl_jax.choices.checks import require_whole
from hitl_jax.choices.registry import Registry, having


def _require_usable(learner: BoundaryLearner) -> None:
    """Checks what a learner says of itself; raises InvalidValue."""
    require_whole("num_updates", learner.num_updates, at_least=1)
    require_whole("least_frames", learner.least_frames, at_least=1)


BOUNDARY_LEARNERS: Registry[BoundaryLearner] = Registry(
    "boundary learner", "boundary_learner", having(*NEEDS), require=_require_usable
)
"""Each is made from an `AgentConfig`."""


@BOUNDARY_LEARNERS.register("printed", "with a critic of state and boundary")
def printed(config: Sizes) -> PrintedLearner:
    """Lines 10 to 12 as they stand in the paper."""
    return PrintedLearner(config.observation_size, config.boundary_hidden_sizes)


@BOUNDARY_LEARNERS.register("margin", "with a critic of state and alarm")
def margin(config: Sizes) -> MarginLearner:
    """Lines 10 to 12 over the margin |c| − τ."""
    return MarginLearner(config.observation_size, config.boundary_hidden_sizes, config.margin_parts)
