"""What each ablation compares."""

import dataclasses

from hitl_jax.boundary.margin import MARGIN_PARTS
from hitl_jax.config import Method
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
class Ablation:
    """One table.

    Attributes:
        title: what is taken apart.
        settings: its rows.
        is_number: whether the settings are values of one number, with which their labels begin;
            the figure then has curves over it.
    """

    title: str
    settings: tuple[Setting, ...]
    is_number: bool = False


def _each(option: str, values: tuple[float, ...], methods: tuple[Method, ...]) -> list[Setting]:
    return [Setting(f"{value:g}", {option: value}, methods) for value in values]


_TRAINED = "results/ten_seeds/runs/hitl-fix/seed-0009/params.npz"

_TAKEOVER: Changes = {"intervention": "takeover"}
_HELD: Changes = _TAKEOVER | {
    "takeover_steps": 50,
    "human_actions": "trained",
    "feedback_schedule": "onset",
}
"""A takeover by a walker that can walk, for at least a second."""
_NETWORK: Changes = {"boundary_source": "network"}
_RESIDUAL: Changes = {"boundary_source": "residual"}

_BUDGET = 0.0024
"""Interventions per step of HITL-AC in its first 300 episodes (results/ten_seeds)."""

_RANDOM: Changes = {
    "boundary_low": 0.0,
    "initial_boundary": 0.0,  # an alarm at every step
    "tolerance": 1000.0,  # no state is dangerous
    "mistake_rate": _BUDGET,
}
"""A human who intervenes at random."""

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
"""The defaults, but `ddpg` and human steps as any other; `foresight_120` in results/README.md, but
for the delay."""


_IMITATION: Changes = {"human_data": "imitation"}
_WEIGHT_50: Changes = {"extra": {"imitation_weight": 50.0}}
_FASTEST: Changes = _FORESIGHT | {"learner": "td3-tqc"}
_DEFAULT: Changes = _FASTEST | _IMITATION
"""Of `BASE`, what makes the defaults of it."""
_AVERAGED: Changes = _DEFAULT | {"noise_steps": 300_000, "tested_actor": "average"}
"""The options of `averaged` in results/README.md."""


_PRICES = (5.0, 10.0, 14.0)
"""Less than ρ."""


def _without(part: str) -> Setting:
    parts = tuple(other for other in MARGIN_PARTS if other != part)
    return Setting(f"without {part}", _FORESIGHT | {"margin_parts": parts})


ABLATIONS: dict[str, Ablation] = {
    "methods": Ablation(
        "The three methods",
        (Setting("base", methods=tuple(Method)),),
    ),
    "intervention": Ablation(
        "What an intervention does",
        (
            Setting("reset, terminal (base)"),
            Setting("reset, truncated", {"human_reset_terminates": False}),
            Setting("takeover", _TAKEOVER),
            Setting("takeover, noisy hands", _TAKEOVER | {"human_action_noise": 0.3}),
            Setting("takeover, trained hands", _TAKEOVER | {"human_policy": _TRAINED}),
            Setting("penalty", {"intervention": "penalty"}),
        ),
    ),
    "exploration": Ablation(
        "Standard deviation of action noise that does not fade",
        (
            Setting("0.1", _DEFAULT | {"exploration_noise": 0.1}, tuple(Method)),
            Setting("0.3 (default)", _DEFAULT, tuple(Method)),
        ),
        is_number=True,
    ),
    "fading": Ablation(
        "To what action noise of 0.3 fades over 300,000 steps",
        (
            Setting("not at all (default)", _DEFAULT, tuple(Method)),
            Setting(
                "to 0.1", _DEFAULT | {"noise_steps": 300_000, "final_noise": 0.1}, tuple(Method)
            ),
        ),
    ),
    "feedback": Ablation(
        "The human's feedback r(s, a^h)",
        (
            Setting("0", {"feedback": 0.0}),
            Setting("-5", {"feedback": -5.0}),
            Setting("-20 (base)"),
            Setting("-100", {"feedback": -100.0}),
            Setting("-20, takeover, each step", _TAKEOVER),
            Setting("-20, takeover, once", _TAKEOVER | {"feedback_schedule": "episode"}),
        ),
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
    ),
    "source": Ablation(
        "How the network and the Δ rule make the boundary",
        (
            Setting("rule (base)"),
            Setting("network", _NETWORK),
            Setting("network, ρ = 0", _NETWORK | {"alarm_reward": 0.0}),
            Setting("network, ρ = 10", _NETWORK | {"alarm_reward": 10.0}),
            Setting("residual", _RESIDUAL),
            Setting("residual, ρ = 0", _RESIDUAL | {"alarm_reward": 0.0}),
        ),
    ),
    "delta": Ablation(
        "The steps of the boundary [rad]",
        (
            Setting("Δ = 0.0001", {"delta_minus": 1e-4, "delta_plus": 1e-4}),
            Setting("Δ = 0.001 (base)"),
            Setting("Δ = 0.01", {"delta_minus": 1e-2, "delta_plus": 1e-2}),
            Setting("Δ⁻ = 0.003, Δ⁺ = 0.001", {"delta_minus": 3e-3}),
            Setting("Δ⁻ = 0.001, Δ⁺ = 0.003", {"delta_plus": 3e-3}),
        ),
    ),
    "initial-boundary": Ablation(
        "τ_0 [rad]",
        (
            *_each("initial_boundary", (0.2, 0.45), _HUMAN),
            Setting("0.7 (base)", methods=_HUMAN),
            *_each("initial_boundary", (1.0, 1.4), _HUMAN),
        ),
        is_number=True,
    ),
    "indicator": Ablation(
        "The safety indicator",
        (
            Setting("hull angle (base)"),
            Setting("weighted: the angle in 0.1 s", {"indicator": "weighted"}),
            Setting(
                "weighted; the human looks 0.1 s ahead",
                {"indicator": "weighted", "danger": "predictive", "horizon": 0.1},
            ),
        ),
    ),
    "human-tolerance": Ablation(
        "The human's threshold of danger [rad]",
        (
            *_each("tolerance", (0.3,), _AC),
            Setting("0.45 (base)"),
            *_each("tolerance", (0.6, 0.8), _AC),
        ),
        is_number=True,
    ),
    "human-delay": Ablation(
        "The human's reaction delay [steps of 0.02 s]",
        (
            Setting("0 (base)", methods=_HUMAN),
            *_each("delay", (10, 25), _HUMAN),
        ),
        is_number=True,
    ),
    "human-mistakes": Ablation(
        "Share of wrong judgements",
        (
            Setting("0 (base)", methods=_HUMAN),
            *_each("mistake_rate", (0.1, 0.3), _HUMAN),
        ),
        is_number=True,
    ),
    "human-attention": Ablation(
        "Lapses and limited attention",
        (
            Setting("always there (base)", methods=_HUMAN),
            Setting("misses 30 % of the steps", {"lapse_rate": 0.3}, _HUMAN),
            Setting("at most 100 interventions", {"max_interventions": 100}, _HUMAN),
            Setting("a rest of 500 steps", {"refractory_steps": 500}, _HUMAN),
        ),
    ),
    "arbiter": Ablation(
        "Other arbiters; quantile, PID and random are given the rate of HITL-AC",
        (
            Setting("Δ rule (base)"),
            Setting("fixed", methods=(Method.HITL_FIX,)),
            Setting("quantile", {"boundary_source": "quantile", "target_rate": _BUDGET}),
            Setting("PID", {"boundary_source": "pid", "target_rate": _BUDGET}),
            Setting("random", _RANDOM, (Method.HITL_FIX,)),
            Setting("Δ rule, takeover", _TAKEOVER),
            Setting("Δ rule, takeover, hysteresis", _TAKEOVER | {"release": "hysteresis"}),
        ),
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
    ),
    "boundary-start": Ablation(
        "τ_0 of an executed boundary [rad]",
        tuple(
            Setting(f"{start:g}", _FORESIGHT | {"initial_boundary": start})
            for start in (0.1, 0.4, 0.7, 1.0, 1.4)
        ),
        is_number=True,
    ),
    "fixed-boundary": Ablation(
        "A fixed boundary, and one that is learned from there: τ_0 [rad]",
        tuple(
            Setting(
                f"{start:g}",
                _AVERAGED | {"initial_boundary": start},
                _HUMAN if start else _FIX,
            )
            for start in (0.0, 0.1, 0.3, 0.7)
        ),
        is_number=True,
    ),
    "human-price": Ablation(
        "What the human's coming costs the boundary learner: p, in units of reward",
        (
            Setting("0 (default)", _DEFAULT),
            *(Setting(f"{price:g}", _DEFAULT | {"human_price": price}) for price in _PRICES),
        ),
        is_number=True,
    ),
    "human-data": Ablation(
        "What the task learner makes of the human's steps",
        (
            Setting("transitions", _FASTEST, _HUMAN),
            Setting("half", _FASTEST | {"human_data": "half"}, _HUMAN),
            Setting("imitation, weight 10 (default)", _FASTEST | _IMITATION, _HUMAN),
            Setting("weight 50", _FASTEST | _IMITATION | _WEIGHT_50, _HUMAN),
        ),
    ),
}
