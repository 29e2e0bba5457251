"""What the figures draw, read from a results folder."""

from typing import Any, NamedTuple

import numpy as np

from hitl_jax.analysis.claims_for_human_time import human_seconds
from hitl_jax.analysis.figure_style import literal
from hitl_jax.analysis.summary import (
    NOT_TESTED,
    SkillOverTraining,
    skill_over_training,
    was_tested,
)
from hitl_jax.analysis.task_facts import solved_of
from hitl_jax.results.config_diff import flatten
from hitl_jax.results.episode_tables import METHODS, Table
from hitl_jax.results.folder import ResultsFolder, Run


class MethodData(NamedTuple):
    """One method's data: training episodes of all runs, test episodes of the finished ones.

    Attributes:
        name: of the method.
        training: of each run.
        played: the same without the episodes that a diverged run could not play, which count as
            falls in `training`.
        unfinished: how many of these runs are under way.
        tests: of each run that was tested.
        progress: autonomous tests during training.
        human_seconds: time in human hands until each of these, [S, P].
        assisted: tests during training with the human.
    """

    name: str
    training: list[Table]
    played: list[Table]
    unfinished: int
    tests: list[Table]
    progress: SkillOverTraining
    human_seconds: np.ndarray
    assisted: SkillOverTraining

    def column(self, name: str) -> list[np.ndarray]:
        """A column of the training episodes of each run."""
        return [table[name] for table in self.training]


class BoundaryRule(NamedTuple):
    """Line 8 of Algorithm 1, where it is executed.

    Attributes:
        initial: τ_0.
        minus: Δ⁻, by which a true alarm lowers τ.
        plus: Δ⁺, by which a false alarm raises τ.
        has_actor: whether an actor's output is added.
    """

    initial: float
    minus: float
    plus: float
    has_actor: bool


class FigureData(NamedTuple):
    """Everything that figures 4 to 7 draw.

    Attributes:
        methods: those with data.
        window: episodes over which returns are averaged.
        boundary_label: of an axis.
        rule: how τ moves; None where another rule is executed.
        tolerance: the human's threshold in the indicator's unit; None where there is none.
        solved: the return that solves the task; None where none is known.
    """

    methods: list[MethodData]
    window: int
    boundary_label: str
    rule: BoundaryRule | None
    tolerance: float | None
    solved: float | None

    @property
    def trained(self) -> list[MethodData]:
        """Methods with training episodes."""
        return [m for m in self.methods if m.training]

    @property
    def with_human(self) -> list[MethodData]:
        """Methods with a human, with training episodes that were played."""
        return [m for m in self.methods if m.played and m.name != "srl"]

    @property
    def return_label(self) -> str:
        """Of an axis of smoothed training returns."""
        return f"training return\n({self.averaged})"

    @property
    def averaged(self) -> str:
        """What the points of a smoothed curve are, of each seed."""
        return f"mean of the last {self.window} episodes"


def load(folder: ResultsFolder, runs: list[Run] | None = None) -> FigureData:
    """The data of a folder, those of unfinished runs included.

    Args:
        folder: the results.
        runs: its finished runs; None reads them.

    Raises:
        ResultsError: if the folder or a run is damaged.
    """
    runs = folder.load_all() if runs is None else runs
    partials = folder.load_partials()
    methods = []
    for name in METHODS:
        finished = [run for run in runs if run.key.method == name]
        begun = [t for key, t in partials.items() if key.method == name and len(t["episode"])]
        training = [run.episodes for run in finished if len(run.episodes["episode"])] + begun
        played = [run.played for run in finished if len(run.played["episode"])] + begun
        tested = [run for run in finished if (run.tests["mode"] == "autonomous").any()]
        often = list(filter(was_tested, tested))
        helped = often if all(was_tested(run, "assisted") for run in often) else []
        if training or tested:
            progress = skill_over_training(often) if often else NOT_TESTED
            assisted = skill_over_training(helped, "assisted") if helped else NOT_TESTED
            tests = [run.tests for run in tested]
            seconds = np.array([human_seconds(run, progress.points) for run in often])
            shown = (name, training, played, len(begun), tests, progress, seconds, assisted)
            methods.append(MethodData(*shown))
    longest = max((len(t["episode"]) for m in methods for t in m.training), default=0)
    window = int(np.clip(longest // 10, 20, 100))
    config = folder.load_config()
    rule, tolerance = _boundary_rule(config), tolerance_in(folder)
    return FigureData(methods, window, boundary_label(folder), rule, tolerance, solved_of(config))


def _boundary_rule(config: dict[str, Any]) -> BoundaryRule | None:
    source = config.get("agent", {}).get("boundary_source")
    numbers = config.get("hyper", {})
    initial, minus, plus = (
        numbers.get(name) for name in ("initial_boundary", "delta_minus", "delta_plus")
    )
    if source not in ("rule", "residual") or None in (initial, minus, plus):
        return None
    return BoundaryRule(initial, minus, plus, source == "residual")


_UNITS = {
    "hull_angle": "rad",
    "hull_angular_velocity": "rad/s",
    "weighted": "rad",
    "lander_tilt": "rad",
    "fall_risk": "probability of a fall",
}
"""Of the indicators, for figures; they import no JAX."""


def boundary_label(folder: ResultsFolder) -> str:
    """What an axis of boundaries is called: they have the unit of the folder's indicator."""
    config = flatten(folder.load_config())
    indicators = [value for key, value in config.items() if key.split(".")[-1] == "indicator"]
    units = {_UNITS.get(name, f"unit of {name}") for name in indicators or ["hull_angle"]}
    return literal(f"boundary [{' or '.join(sorted(units))}]")


def tolerance_in(folder: ResultsFolder) -> float | None:
    """The human's own threshold, where it is one for the folder's indicator, the hull angle."""
    config = flatten(folder.load_config())
    if (config.get("agent.indicator"), config.get("agent.danger")) != ("hull_angle", "threshold"):
        return None
    return config.get("hyper.human.tolerance")
