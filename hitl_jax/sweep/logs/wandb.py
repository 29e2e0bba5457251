"""Runs of Weights & Biases, grouped by method.

Without an account or a network: `WANDB_MODE=offline`, and `wandb sync` later.
"""

import os
from collections.abc import Mapping
from typing import Any

from hitl_jax.sweep.logs.run_log import LOGS, LoggedRun


@LOGS.register("wandb", "Weights & Biases; WANDB_PROJECT, WANDB_MODE=offline and such are obeyed")
class WandbLog:
    """One run there."""

    def __init__(self, run: LoggedRun):
        """Begins it."""
        import wandb

        key = run.key
        self._run: Any = wandb.init(
            project=os.environ.get("WANDB_PROJECT", "hitl_jax"),
            dir=run.folder,
            group=str(key.method),
            name=f"{key.method} seed {key.seed}",
            config={"method": str(key.method), "seed": key.seed, **run.config},
            reinit="create_new",
            settings=wandb.Settings(silent=True, console="off", x_disable_stats=True),
        )
        self._run.define_metric("*", step_metric=STEP)

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Writes some numbers; see `RunLog.write`."""
        self._run.log({STEP: step, **values})

    def close(self) -> None:
        """Writes what is left, and ends."""
        self._run.finish()


STEP = "env_steps"
"""Over which numbers are drawn."""
