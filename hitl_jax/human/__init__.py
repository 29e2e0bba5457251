"""The simulated human: what they see, how they judge it, and what they do with the controls."""

from hitl_jax.human.danger import DANGER_MODELS, predictive, threshold
from hitl_jax.human.experience import experienced
from hitl_jax.human.foresight import foresight
from hitl_jax.human.judgement import ALL_PARTS, outcome_dangerous, recorded, simulated_human
from hitl_jax.human.params import MAX_DELAY, UNLIMITED, HumanParams, validate_human_params
from hitl_jax.human.part import HumanPart, chain, memoryless
from hitl_jax.human.parts import HUMAN_PARTS, Attention, attentive, delayed, lapsing, mistaken
from hitl_jax.human.trained_walker import trained_walker

__all__ = [
    "ALL_PARTS",
    "DANGER_MODELS",
    "HUMAN_PARTS",
    "MAX_DELAY",
    "UNLIMITED",
    "Attention",
    "HumanParams",
    "HumanPart",
    "attentive",
    "chain",
    "delayed",
    "experienced",
    "foresight",
    "lapsing",
    "memoryless",
    "mistaken",
    "outcome_dangerous",
    "predictive",
    "recorded",
    "simulated_human",
    "threshold",
    "trained_walker",
    "validate_human_params",
]
