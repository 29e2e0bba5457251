"""The configurations that are tuned, and the options of a tuning."""

import dataclasses
from typing import Annotated

import tyro

from hitl_jax.choices.checks import require_seeds, require_whole
from hitl_jax.errors import InvalidValue
from hitl_jax.evaluation.trials import MOST_TEST_EPISODES
from hitl_jax.sweep.changes import Changes
from hitl_jax.sweep.presets import PAPER
from hitl_jax.training.run_spec import LoopConfig

BASE: Changes = PAPER | {
    "learner": "td3",
    "hidden_sizes": (128, 128),
    "layer_norm": False,
    "batch_size": 128,
    "n_step": 4,
    "updates_per_step": 0.5,
    "noise_free_every": 0,
    "exploration_noise": 0.2,
}

_NORM: Changes = {"batch_size": 64, "layer_norm": True}
_QUIET: Changes = _NORM | {"noise_free_every": 4}
_TQC: Changes = _QUIET | {"learner": "td3-tqc"}
_SLOW: Changes = {"actor_learning_rate": 5e-4, "critic_learning_rate": 5e-4}

CONFIGURATIONS: dict[str, Changes] = {
    "128-batch-128": {},
    "128-batch-64": {"batch_size": 64},
    "128-batch-64-norm": _NORM,
    "128-batch-64-norm-quiet": _QUIET,
    "64-batch-64-norm-quiet": _QUIET | {"hidden_sizes": (64, 64)},
    "128-batch-64-norm-quiet-lr-5e-4": _QUIET | _SLOW,
    "128-batch-64-norm-quiet-n-8": _QUIET | {"n_step": 8},
    "128-batch-64-norm-quiet-tqc": _TQC,
    "128-batch-64-norm-quiet-tqc-noise-0.3": _TQC | {"exploration_noise": 0.3},
    "128-batch-64-norm-quiet-tqc-quarter": _TQC | {"updates_per_step": 0.25},
}
"""What each configuration changes of `BASE`, by the names of the options."""

STAGES = 3
"""Parts of a run after each of which it is measured."""


@dataclasses.dataclass(frozen=True)
class TuningOptions:
    """Train the three methods with several learners and compare return with time.

    Attributes:
        configurations: some of 128-batch-128, 128-batch-64, 128-batch-64-norm,
            128-batch-64-norm-quiet, 64-batch-64-norm-quiet, 128-batch-64-norm-quiet-lr-5e-4,
            128-batch-64-norm-quiet-n-8, 128-batch-64-norm-quiet-tqc,
            128-batch-64-norm-quiet-tqc-noise-0.3, 128-batch-64-norm-quiet-tqc-quarter (hidden
            units, minibatch, what else; `quiet` plays every fourth training episode without action
            noise, `quarter` makes one update in four ticks).
        seeds: number of seeds for each method.
        first_seed: the first of them; a sweep reports others.
        ticks: ticks of a run: environment steps and resets.
        test_episodes: autonomous test episodes of a run.
        out: folder of the results, a file a configuration and a table of those of equal budget.
    """

    configurations: Annotated[tuple[str, ...], tyro.conf.arg(name="only")] = tuple(CONFIGURATIONS)
    seeds: int = 5
    first_seed: int = 100
    ticks: int = 200_000
    test_episodes: int = 20
    out: str = "runs/tuning"

    @property
    def budget(self) -> dict[str, int]:
        """What must be equal for two configurations to be compared."""
        names = ("seeds", "first_seed", "ticks", "test_episodes")
        return {name: getattr(self, name) for name in names}

    def checked(self) -> "TuningOptions":
        """Checks every option; returns itself.

        Raises:
            InvalidValue: one line with the name, the value and what is allowed.
        """
        unknown = [name for name in self.configurations if name not in CONFIGURATIONS]
        if unknown or not self.configurations:
            given = " ".join(self.configurations) or "(none)"
            raise InvalidValue("only", given, f"must be some of {', '.join(CONFIGURATIONS)}")
        require_seeds(self.first_seed, self.seeds)
        require_whole("test_episodes", self.test_episodes, 1, MOST_TEST_EPISODES)
        require_whole("ticks", self.ticks, at_least=STAGES * LoopConfig().chunk)
        return self
