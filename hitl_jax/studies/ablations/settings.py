"""What each ablation compares."""

import dataclasses
from typing import Any

from hitl_jax.boundary.margin import MARGIN_PARTS
from hitl_jax.config import Method
from hitl_jax.envs import WALKER
from hitl_jax.sweep.changes import Changes
from hitl_jax.sweep.presets import PAPER

BASE: Changes = PAPER | {"learner": "td3-tqc"}
"""What settings change: the preset `paper` with the learner that trains fastest."""

_AC = (Method.HITL_AC,)
_FIX = (Method.HITL_FIX,)
_HUMAN = (Method.HITL_FIX, Method.HITL_AC)


@dataclasses.dataclass(frozen=True)
class Setting:
    """One row of a table.

    Attributes:
        label: its name in table and figure.
        changes: of `BASE`.
        methods: which methods are run with it.
    """

    label: str
    changes: Changes = dataclasses.field(default_factory=dict)
    methods: tuple[Method, ...] = _AC

    @property
    def name(self) -> str:
        """What it changes, in one canonical line: equal settings of two ablations are run once."""
        return " ".join(f"{name}={value}" for name, value in sorted(self.changes.items()))


@dataclasses.dataclass(frozen=True)
class Budget:
    """How much an ablation is run.

    Attributes:
        seeds: number of seeds for each setting and method.
        first_seed: the first of them; one that chooses a default has those of tuning.
        episodes: training episodes of a run; few where late walkers, which hardly fall, would
            tell nothing.
        test_episodes: test episodes of a run, alone and again with the human.
    """

    seeds: int = 10
    first_seed: int = 100
    episodes: int = 160
    test_episodes: int = 20

    @property
    def of_a_run(self) -> dict[str, int]:
        """What must be equal for two runs to be compared."""
        return {"episodes": self.episodes, "test_episodes": self.test_episodes}

    @property
    def told(self) -> str:
        """In words."""
        return (
            f"Seeds {self.first_seed} to {self.all_seeds[-1]}, {self.episodes} training episodes, "
            f"{self.test_episodes} test episodes each way."
        )

    @property
    def all_seeds(self) -> range:
        """Of each setting and method."""
        return range(self.first_seed, self.first_seed + self.seeds)


@dataclasses.dataclass(frozen=True)
class Ablation:
    """One table.

    Attributes:
        title: what is taken apart.
        settings: its rows.
        budget: of the kept table, or of the one that is to be kept.
        is_number: whether the settings are values of one number, with which their labels begin;
            the figure then has curves over it.
        base: what the settings change.
        env: the task, see `hitl_jax.tasks.task_of`.
    """

    title: str
    settings: tuple[Setting, ...]
    budget: Budget = Budget()
    is_number: bool = False
    base: Changes = dataclasses.field(default_factory=lambda: BASE)
    env: str = WALKER

    @property
    def of_a_run(self) -> dict[str, Any]:
        """What must be equal for two runs to be compared, beside their options."""
        task = {} if self.env == WALKER else {"env": self.env}
        return self.budget.of_a_run | task


_HELD: Changes = {
    "intervention": "takeover",
    "takeover_steps": 50,
    "human_actions": "trained",
    "feedback_schedule": "onset",
}
"""A takeover by a walker that can walk, for at least a second."""

_FORESIGHT: Changes = {
    "learner": "ddpg",
    "boundary_source": "network",
    "boundary_learner": "margin",
    "boundary_hidden_sizes": (64, 64),
    "danger": "experienced",
    "delay": 10,
    "human_actions": "trained",
    "intervention": "takeover",
    "takeover_steps": 50,
    "feedback_schedule": "onset",
    "feedback": -10.0,
    "alarm_reward": 15.0,
    "noise_free_every": 2,
    "unattended_every": 4,
    "boundary_low": 0.0,
    "boundary_noise": 0.1,
    "boundary_temperature": 10.0,
}
"""The defaults, but `ddpg`, human steps as any other, action noise that stays and tests of the last
parameters; `foresight_120` in results/README.md, but for the delay."""


_IMITATION: Changes = {"human_data": "imitation"}
_WEIGHT_50: Changes = {"extra": {"imitation_weight": 50.0}}
_FASTEST: Changes = _FORESIGHT | {"learner": "td3-tqc"}
_STEADY: Changes = _FASTEST | _IMITATION
"""The defaults, but action noise that stays and tests of the last parameters."""
_DEFAULT: Changes = _STEADY | {"noise_steps": 300_000, "tested_actor": "average"}
"""Of `BASE`, what makes the defaults of it."""


_PRICES = (5.0, 10.0, 14.0)
"""Less than ρ."""


def _without(part: str) -> Setting:
    parts = tuple(other for other in MARGIN_PARTS if other != part)
    return Setting(f"without {part}", _FORESIGHT | {"margin_parts": parts})


ABLATIONS: dict[str, Ablation] = {
    "exploration": Ablation(
        "Standard deviation of action noise that does not fade",
        (
            Setting("0.1", _STEADY | {"exploration_noise": 0.1}, tuple(Method)),
            Setting("0.3", _STEADY, tuple(Method)),
        ),
        is_number=True,
    ),
    "fading": Ablation(
        "To what action noise of 0.3 fades over 300,000 steps",
        (
            Setting("not at all", _STEADY, tuple(Method)),
            Setting(
                "to 0.1", _STEADY | {"noise_steps": 300_000, "final_noise": 0.1}, tuple(Method)
            ),
        ),
        Budget(episodes=400, test_episodes=100),
    ),
    "loophole": Ablation(
        "Where being reset pays: intervention, feedback, and whether a reset ends the bootstrap",
        (
            *(
                Setting(
                    f"reset, {end}, {feedback:g}",
                    {"human_reset_terminates": end == "terminal", "feedback": feedback},
                    _FIX,
                )
                for end in ("terminal", "truncated")
                for feedback in (0.0, -20.0, -100.0)
            ),
            Setting("takeover, 0", _HELD | {"feedback": 0.0}, _FIX),
            Setting("takeover, onset, -10", _HELD | {"feedback": -10.0}, _FIX),
            Setting(
                "takeover, each step, -20",
                _HELD | {"feedback": -20.0, "feedback_schedule": "step"},
                _FIX,
            ),
            Setting("the default", _DEFAULT, _FIX),
        ),
        Budget(first_seed=0, episodes=300),
    ),
    "boundary-parts": Ablation(
        "What the boundary learner is made of",
        (
            Setting("all of margin", _FORESIGHT),
            *(_without(part) for part in MARGIN_PARTS),
            Setting("without a temperature", _FORESIGHT | {"boundary_temperature": 0.0}),
            Setting(
                "printed",
                _FORESIGHT | {"boundary_learner": "printed", "boundary_temperature": 0.0},
            ),
        ),
        Budget(first_seed=0, episodes=120),
    ),
    "initial-boundary": Ablation(
        "A fixed boundary, and one that is learned from there: τ_0 [rad]",
        (
            Setting("0", _DEFAULT | {"initial_boundary": 0.0}, _FIX),
            Setting("0.1", _DEFAULT | {"initial_boundary": 0.1}, _HUMAN),
            Setting("0.3", _DEFAULT | {"initial_boundary": 0.3}, _HUMAN),
            Setting("0.7 (default)", _DEFAULT, _HUMAN),
            Setting("1", _DEFAULT | {"initial_boundary": 1.0}),
            Setting("1.4", _DEFAULT | {"initial_boundary": 1.4}),
        ),
        Budget(test_episodes=100),
        is_number=True,
    ),
    "human-price": Ablation(
        "What the human's coming costs the boundary learner: p, in units of reward",
        (
            Setting("0", _STEADY),
            *(Setting(f"{price:g}", _STEADY | {"human_price": price}) for price in _PRICES),
        ),
        is_number=True,
    ),
    "human-data": Ablation(
        "What the task learner makes of the human's steps",
        (
            Setting("transitions", _FASTEST, _HUMAN),
            Setting("half", _FASTEST | {"human_data": "half"}, _HUMAN),
            Setting("imitation, weight 10", _FASTEST | _IMITATION, _HUMAN),
            Setting("weight 50", _FASTEST | _IMITATION | _WEIGHT_50, _HUMAN),
        ),
        Budget(episodes=120),
    ),
}
