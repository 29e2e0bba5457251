"""The risk critic: the probability that the walker falls soon, learned from what happened."""

from hitl_jax.risk.learner import RiskLearner
from hitl_jax.risk.losses import risk_loss, risk_target

__all__ = ["RiskLearner", "risk_loss", "risk_target"]
