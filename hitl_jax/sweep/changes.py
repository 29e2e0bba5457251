"""Configurations told by what they change of the defaults."""

import dataclasses
import functools
from typing import Any, NamedTuple

from hitl_jax.config import AgentConfig, Hyper, validate_hyper
from hitl_jax.envs import OUR_WALKERS, default_backend, make_pool
from hitl_jax.errors import InvalidValue, Unplayable
from hitl_jax.human.judgement import HumanParams
from hitl_jax.tasks import task_of
from hitl_jax.training.run_spec import LoopConfig

Changes = dict[str, Any]
"""Values by the names of the options; those of the human without `human.`."""


class Parts(NamedTuple):
    """All options that define a run's numbers, but for its method and seed.

    Attributes:
        agent: static choices.
        loop: how much is played and learned.
        hyper: traced hyperparameters.
        human_policy: a `params.npz` whose actor gives a^h; None: as `human_actions` says.
    """

    agent: AgentConfig
    loop: LoopConfig
    hyper: Hyper
    human_policy: str | None


def of_task(env: str, changes: Changes) -> Parts:
    """The defaults of a task with some changes; where both name an option, the task's holds.

    Args:
        env: see `task_of`.
        changes: of presets.

    Raises:
        ValueError: one line, if the task cannot be had, or changes what is no option.
    """
    told = changes_of_task(env)
    try:
        return changed(changes | told)
    except ValueError as error:
        raise InvalidValue("env", env, f"its task changes options: {error}") from error


def changes_of_task(env: str) -> Changes:
    """What a task changes; the environment is asked for sizes that the task does not say.

    Raises:
        InvalidValue: one line, if the task cannot be had, or its environment not be played.
    """
    if not env:
        raise InvalidValue("env", repr(env), "must name an environment")
    task = task_of(env)
    told = dict(task.changes)
    if task.env_id in OUR_WALKERS or told.keys() >= {"observation_size", "action_size"}:
        return told
    try:
        return _sizes_of(task.env_id) | told
    except Unplayable as error:
        raise InvalidValue("env", env, error.why) from error


@functools.cache
def _sizes_of(env_id: str) -> Changes:
    with make_pool(default_backend(env_id), 1, env_id=env_id) as pool:
        return {"observation_size": pool.observation_size, "action_size": pool.action_size}


def changed(changes: Changes) -> Parts:
    """The defaults with some changes.

    Raises:
        ValueError: one line, if there is no such option or a value is not allowed.
    """
    used: set[str] = set()

    def change(default: Any, *others: str) -> Any:
        known = {field.name for field in dataclasses.fields(default)}
        names = (known & changes.keys()).difference(others)
        used.update(names)
        return dataclasses.replace(default, **{name: changes[name] for name in names})

    hyper = dataclasses.replace(change(Hyper()), human=change(HumanParams(), "extra"))
    validate_hyper(hyper)
    parts = Parts(change(AgentConfig()), change(LoopConfig()), hyper, human_policy=None)
    if unknown := changes.keys() - used:
        raise ValueError(f"{', '.join(sorted(unknown))}: no such option")
    return parts
