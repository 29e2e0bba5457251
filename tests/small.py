"""One small team for all tests that train, so that they share its compiled programs."""

from hitl_jax.config import AgentConfig
from hitl_jax.training.run_spec import LoopConfig

AGENT = AgentConfig(learner="td3", hidden_sizes=(16,), batch_size=16, boundary_hidden_sizes=(8,))
LOOP = LoopConfig(capacity=2000)

TEAM = {
    "learner": AGENT.learner,
    "hidden_sizes": AGENT.hidden_sizes,
    "batch_size": AGENT.batch_size,
    "boundary_hidden_sizes": AGENT.boundary_hidden_sizes,
    "capacity": LOOP.capacity,
}
OPTIONS = tuple(
    word
    for name, value in TEAM.items()
    for word in ("--" + name.replace("_", "-"), str(value).strip("(,)"))
)
