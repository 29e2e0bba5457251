"""Event files for TensorBoard, by tensorboardX: `tensorboard --logdir RESULTS/tensorboard`."""

import shutil
from collections.abc import Mapping

from hitl_jax.sweep.logs.run_log import LOGS, LoggedRun

FOLDER = "tensorboard"
"""In the folder of results; in it each run has its own."""


@LOGS.register("tensorboard", "event files in the folder `tensorboard` of the results")
class TensorBoardLog:
    """The event file of one run."""

    def __init__(self, run: LoggedRun):
        """Begins it anew."""
        from tensorboardX import SummaryWriter

        folder = run.folder / FOLDER / str(run.key.method) / f"seed-{run.key.seed:04d}"
        shutil.rmtree(folder, ignore_errors=True)
        self._writer = SummaryWriter(str(folder), write_to_disk=True)

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Writes some numbers; see `RunLog.write`."""
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Writes what is left, and ends."""
        self._writer.close()
