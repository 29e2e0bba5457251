"""Logs of runs in the formats of other tools, written while a sweep goes on.

To add one, write a module beside this one that registers a function which makes a `RunLog`.
"""

from hitl_jax.sweep.logs import tensorboard as tensorboard
from hitl_jax.sweep.logs import wandb as wandb
from hitl_jax.sweep.logs.run_log import LOGS, RunLog
from hitl_jax.sweep.logs.sweep_logs import SweepLogs

__all__ = ["LOGS", "RunLog", "SweepLogs"]
