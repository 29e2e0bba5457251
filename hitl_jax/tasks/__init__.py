"""Environments by name, and what a sweep must know of each."""

from hitl_jax.tasks import bipedal_walker as bipedal_walker
from hitl_jax.tasks import lunar_lander as lunar_lander
from hitl_jax.tasks.task import EVERY_END, TASKS, Task, facts, task_of

__all__ = ["EVERY_END", "TASKS", "Task", "facts", "task_of"]
