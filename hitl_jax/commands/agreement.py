"""How well `hitl_jax.walker` agrees with Box2D: `hitl-jax agreement`."""

import dataclasses
import pathlib
from collections.abc import Callable

import jax

from hitl_jax.agreement.accelerator import measure_accelerator
from hitl_jax.agreement.returns import measure_scripted, measure_trained
from hitl_jax.agreement.states import measure_rollout, measure_step
from hitl_jax.choices.checks import MOST_SEED, require_whole
from hitl_jax.console.cli import BadInput, checking_input
from hitl_jax.console.output import print_rows, say
from hitl_jax.envs import HARDCORE_WALKER, WALKER, require_backend
from hitl_jax.results.episode_measures import Row


@dataclasses.dataclass(frozen=True)
class AgreementOptions:
    """Compare the walker in JAX with gymnasium's: one step, rollouts, returns, trained walkers.

    Where JAX has an accelerator, it also compares the walker there with the same on the CPU.

    Attributes:
        only: parts: some of step, rollout, scripted, trained, accelerator; all by default, but for
            trained with --hardcore, since nobody has trained there, and for accelerator where JAX
            has none.
        hardcore: on terrain with stumps, stairs and pits.
        episodes: of the scripted walker in each environment.
        test_episodes: of a trained walker in each.
        trained: folders of sweeps whose walkers are played; each is at home in the environment that
            it was trained in.
        runs: trained walkers of a folder, spread over its methods.
        seed: of the states that are compared.
    """

    only: tuple[str, ...] = ()
    hardcore: bool = False
    episodes: int = 1000
    test_episodes: int = 100
    trained: tuple[str, ...] = ("results/ten_seeds",)
    runs: int = 6
    seed: int = 0

    @property
    def env_id(self) -> str:
        """Of gymnasium."""
        return HARDCORE_WALKER if self.hardcore else WALKER


def main(options: AgreementOptions) -> int:
    """Measures, and prints a table a part.

    Args:
        options: what to compare.

    Returns:
        The exit code.
    """
    lacks = {"trained": options.hardcore, "accelerator": jax.default_backend() == "cpu"}
    there_are = [part for part in PARTS if not lacks.get(part)]
    parts = [part for given in options.only for part in given.split(",")] or there_are
    if not set(parts) <= set(there_are):
        raise BadInput(f"--only {' '.join(options.only)}: must be some of {', '.join(there_are)}")
    with checking_input():
        for name in ("episodes", "test_episodes", "runs"):
            require_whole(name, getattr(options, name), at_least=1)
        require_whole("seed", options.seed, at_most=MOST_SEED)
        for part in parts:
            if part != "accelerator":
                require_backend("gymnasium" if part in ("step", "rollout") else "lean")
    for folder in options.trained:
        if "trained" in parts and not (pathlib.Path(folder) / "config.json").exists():
            raise BadInput(f"--trained {folder}: holds no results")
    for part in parts:
        print_rows(part, PARTS[part](options))
    return 0


PARTS: dict[str, Callable[[AgreementOptions], list[Row]]] = {
    "step": lambda options: measure_step(options.seed, options.env_id),
    "rollout": lambda options: measure_rollout(options.seed, options.env_id),
    "scripted": lambda options: measure_scripted(options.episodes, options.env_id),
    "trained": lambda options: measure_trained(
        options.trained, options.runs, options.test_episodes, say
    ),
    "accelerator": lambda options: measure_accelerator(options.seed, options.hardcore),
}
