"""The choices of `--preset paper`, with `td3-tqc`: programs are small, the human sees the tilt."""

import dataclasses

from hitl_jax.sweep.changes import changed
from hitl_jax.sweep.presets import PAPER

_PARTS = changed(PAPER | {"learner": "td3-tqc"})


def paper_config(**changes):
    """An `AgentConfig` with some changes."""
    return dataclasses.replace(_PARTS.agent, **changes)


def paper_hyper(**changes):
    """`Hyper` with some changes."""
    return dataclasses.replace(_PARTS.hyper, **changes)
