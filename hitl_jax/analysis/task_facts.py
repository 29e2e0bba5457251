"""What figures and tables must know of the task, from a config; without any it is the walker."""

from typing import Any

STEPS_PER_SECOND = 50.0
"""Of BipedalWalker."""
_SOLVED = 300.0


def solved_of(config: dict[str, Any]) -> float | None:
    """The return from which the task counts as solved; None where none is known."""
    solved: float | None = config.get("task", {}).get("solved", _SOLVED)
    return solved


def steps_per_second_of(config: dict[str, Any]) -> float:
    """Environment steps in a second of the task's time."""
    steps: float = config.get("task", {}).get("steps_per_second", STEPS_PER_SECOND)
    return steps


def marks_of(config: dict[str, Any]) -> tuple[int, ...]:
    """Returns to be reached by the trailing mean: 0, and thirds of what solves the task, rising."""
    solved = solved_of(config)
    if solved is None or solved <= 0:
        return ()
    return tuple(sorted({round(solved * third / 3) for third in range(4)}))
