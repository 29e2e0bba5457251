"""What a sweep must know of an environment beside the environment: a `Task`, by name.

To add one to the package, write a module beside this one that registers it. One of your own needs
no place here: `--env my_module:my_task`.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from hitl_jax.choices.checks import require, require_that, require_whole
from hitl_jax.choices.registry import Registry, is_imported
from hitl_jax.errors import InvalidValue, name_of
from hitl_jax.results.episode_measures import UNKNOWN_ENDS, EndRule

EVERY_END = EndRule(math.inf, goal=False)
"""Of a task whose every end, but for the time limit, is a fall."""


@dataclasses.dataclass(frozen=True)
class Task:
    """An environment, and what holds in it where no option says otherwise.

    Attributes:
        env_id: gymnasium's name; `module:Name-v0` where a module registers it.
        ends: which ends of an episode are falls.
        changes: new defaults of a sweep's options, by name, those of the human without `human.`:
            indicator, danger, human_actions, and what is in their units. They override every
            preset. Without `observation_size` and `action_size` the environment is asked for these.
        episodes: training episodes of a run of the preset `full`; None: as many as there.
        solved: the return from which gymnasium, or you, call the task solved; None where none is
            known.
        steps_per_second: environment steps in a second of the task's time.
    """

    env_id: str
    ends: EndRule = UNKNOWN_ENDS
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    episodes: int | None = None
    solved: float | None = None
    steps_per_second: float = 50.0

    def __post_init__(self) -> None:
        """Checks every field; InvalidValue names it, its value and what is allowed."""
        if not isinstance(self.env_id, str) or not self.env_id:
            raise InvalidValue("env_id", repr(self.env_id), "must name an environment of gymnasium")
        if not isinstance(self.ends, EndRule):
            raise InvalidValue("ends", name_of(self.ends), "must be an EndRule")
        if not isinstance(self.changes, Mapping):
            raise InvalidValue("changes", name_of(self.changes), "must be a mapping of options")
        if self.episodes is not None:
            require_whole("episodes", self.episodes, at_least=1)
        if self.solved is not None:
            require("solved", self.solved)
        require_that(
            "steps_per_second",
            self.steps_per_second,
            lambda number: number > 0,
            "a finite number above 0",
        )


TASKS: Registry[Task] = Registry(
    "task", "env", lambda value: isinstance(value, Task), made_once=False
)


def task_of(env: str) -> Task:
    """What is known of an environment.

    Args:
        env: name of a task in `TASKS`; `module:name` of one of your own; or a name of gymnasium's,
            of which nothing else is known then.

    Raises:
        InvalidValue: one line with the option, the value and what is allowed.
    """
    return TASKS.make(env) if env in TASKS or is_imported(env) else Task(env)


def facts(env: str) -> dict[str, Any]:
    """What of a task stands in a folder of results, beside the options: JSON values.

    Args:
        env: as of `task_of`.
    """
    task = task_of(env)
    falls = task.ends.fall_reward
    return {
        "env": env,
        "env_id": task.env_id,
        "falls": "none known" if falls is None else "all ends" if math.isinf(falls) else falls,
        "goal": task.ends.goal,
        "solved": task.solved,
        "steps_per_second": task.steps_per_second,
    }
