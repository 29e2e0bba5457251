"""Sweeps by name: how large one is, and what it changes of the defaults."""

import dataclasses
from collections.abc import Iterable

from hitl_jax.config import AgentConfig, Hyper
from hitl_jax.sweep.changes import Changes

IDEAL: Changes = {
    "danger": "threshold",
    "tolerance": 0.45,
    "delay": 0,
    "intervention": "reset",
    "human_reset_terminates": True,
    "release": "judgement",
    "human_actions": "scripted",
    "takeover_steps": 10,
    "feedback": -20.0,
    "feedback_schedule": "step",
}
"""A human who judges at once, by the angle that c_t is, and ends the episode."""

PAPER: Changes = IDEAL | {
    "learner": "ddpg",
    "human_data": "transitions",
    "tested_actor": "last",
    "exploration_noise": 0.3,
    "noise_steps": 0,
    "final_noise": 0.0,
    "noise_free_every": 4,
    "unattended_every": 0,
    "boundary_source": "rule",
    "boundary_learner": "printed",
    "boundary_hidden_sizes": (32, 32),
    "indicator": "hull_angle",
    "initial_boundary": 0.7,
    "delta_minus": 0.001,
    "delta_plus": 0.001,
    "boundary_low": 0.05,
    "boundary_high": 1.5,
    "boundary_noise": 0.02,
    "boundary_temperature": 0.0,
    "alarm_reward": 1.0,
}
"""What section IV of the paper says, and for what it leaves open the simplest: its kind of learner,
the human of `IDEAL`, and the Δ rule."""


def _usual(names: Iterable[str]) -> Changes:
    hyper = Hyper()
    usual: Changes = {}
    for default in (AgentConfig(), hyper, hyper.human):
        usual |= {name: getattr(default, name) for name in names if hasattr(default, name)}
    return usual


AS_PRESET = "preset"
HUMAN_PRESETS: dict[str, Changes] = {AS_PRESET: {}, "person": _usual(IDEAL), "ideal": IDEAL}
"""Simulated humans by name: what each changes of what the sweep's preset says."""


@dataclasses.dataclass(frozen=True)
class Preset:
    """What a sweep is where no option says otherwise.

    Attributes:
        seeds: number of seeds for each method.
        episodes: training episodes of a run.
        test_episodes: test episodes of a run.
        changes: of the other options' defaults.
    """

    seeds: int
    episodes: int
    test_episodes: int
    changes: Changes = dataclasses.field(default_factory=dict)


FULL = "full"
PRESETS = {
    FULL: Preset(seeds=10, episodes=400, test_episodes=100),
    "quick": Preset(seeds=2, episodes=100, test_episodes=20),
    "paper": Preset(seeds=10, episodes=1000, test_episodes=100, changes=PAPER),
}
