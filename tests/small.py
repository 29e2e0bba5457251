"""One small team for all tests that train, so that they share its compiled programs."""

from hitl_jax.config import AgentConfig
from hitl_jax.training.run_spec import LoopConfig

AGENT = AgentConfig(learner="td3", hidden_sizes=(16,), batch_size=16)
LOOP = LoopConfig(capacity=2000)

TEAM = {
    "learner": AGENT.learner,
    "hidden_sizes": AGENT.hidden_sizes,
    "batch_size": AGENT.batch_size,
    "capacity": LOOP.capacity,
}
OPTIONS = tuple(
    word
    for name, value in (TEAM | {"hidden_sizes": AGENT.hidden_sizes[0]}).items()
    for word in ("--" + name.replace("_", "-"), str(value))
)
