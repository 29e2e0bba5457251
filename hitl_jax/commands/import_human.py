"""A human for sweeps of a Minari dataset: `hitl-jax import`.

    hitl-jax import walker/me-v0
    hitl-jax sweep --human fitted:runs/minari/walker-me-v0.fitted.npz

The dataset is one of `hitl-jax export`, or has its infos `dangerous`, `judged` and `human_action`.
A network is fitted to the judgements, with the delay that fits best, and another to what the person
did with the controls. Says how well both do on episodes that were held out.
"""

import dataclasses
import pathlib

import numpy as np
import tyro

from hitl_jax.console.cli import checking_input
from hitl_jax.exchange import fitting, minari_files
from hitl_jax.exchange.fitting import Fit
from hitl_jax.results.atomic_files import write_bytes_atomic
from hitl_jax.results.npz_archives import to_npz
from hitl_jax.sweep import fitted_human


@dataclasses.dataclass(frozen=True)
class ImportOptions:
    """Fit a human for sweeps to a Minari dataset.

    Attributes:
        id: name of the dataset.
        root: folder of Minari's datasets.
        out: the file (default: beside the dataset, by its name).
    """

    id: tyro.conf.Positional[str]
    root: pathlib.Path = pathlib.Path("runs/minari")
    out: pathlib.Path | None = None


def main(options: ImportOptions) -> int:
    """Reads, fits, tells and writes.

    Args:
        options: which.

    Returns:
        The exit code.
    """
    with checking_input():
        minari_files.require_id(options.id)
        episodes = minari_files.read(options.root, options.id)
        fit = fitting.fit(episodes)
    out = options.out or options.root / f"{options.id.replace('/', '-')}.fitted.npz"
    write_bytes_atomic(out, to_npz(fit.arrays))
    print("\n".join(report_of(fit)))
    print(f"\nThe person as a human for sweeps: --human {fitted_human.PREFIX}{out}")
    return 0


def report_of(fit: Fit) -> list[str]:
    """How well the fitted human does on episodes that were held out, in lines."""
    lines = [
        f"judgements are foretold best by the state of {fit.delay} steps before",
        f"judgements: agrees on {fit.agrees:.1%} of {fit.steps:,} held-out steps, of which "
        f"{fit.dangerous:.1%} were judged dangerous; misses {fit.missed:.1%} of these, fears "
        f"{fit.feared:.1%} of the others",
    ]
    if "actor/params/Dense_0/kernel" not in fit.arrays:
        return [*lines, f"hands: none, {fit.hand_steps} steps are too few"]
    told = "" if np.isnan(fit.explained) else f", explain {fit.explained:.0%} of held-out actions"
    return [*lines, f"hands: of {fit.hand_steps:,} steps{told}"]
