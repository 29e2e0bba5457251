"""What a log of one run does, behind one interface, and which there are."""

import importlib.util
import pathlib
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from hitl_jax.choices.registry import Registry, having
from hitl_jax.results.run_key import RunKey


class LoggedRun(NamedTuple):
    """The run that a log is of.

    Attributes:
        folder: of the results; a log keeps its files in a folder of its own in it.
        key: method and seed.
        config: all that defines its numbers besides, a nested dict of JSON values.
    """

    folder: pathlib.Path
    key: RunKey
    config: dict[str, Any]


class RunLog(Protocol):
    """The log of one run."""

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Writes some numbers.

        Args:
            values: by name, `group/name`.
            step: environment steps of the run until then.
        """

    def close(self) -> None:
        """Writes what is left, and ends."""


LOGS: Registry[RunLog] = Registry("log", "log", having("write", "close"), made_once=False)
"""Each is made of a `LoggedRun`."""

_NEEDS = {"tensorboard": "tensorboardX", "wandb": "wandb"}


def require_log(name: str) -> None:
    """Notices before any work that a log cannot be written.

    Raises:
        InvalidValue: one line, if there is no such log.
        ImportError: one line that says what to install.
    """
    LOGS.check(name)
    LOGS.value_of(name)
    if name in _NEEDS and importlib.util.find_spec(_NEEDS[name]) is None:
        raise ImportError(f'log {name}: pip install -e ".[log]"')
