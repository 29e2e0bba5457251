"""Checks of values that a caller chose; each raises `InvalidValue`, one line."""

import math
import numbers
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from hitl_jax.errors import InvalidValue

T = TypeVar("T")

MOST = 2**31 - 1
"""The greatest count, of episodes or steps for example: the greatest int32."""
MOST_SEED = 2**32 - 1
"""Of a run's seeds: it is one word of its key."""
_MOST_SEEDS = 100_000
"""Of one command, which holds a list of its runs."""
GREATEST = float(np.finfo(np.float32).max)
"""The greatest number that float32 has."""


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number by its type: Python's or NumPy's, but no truth value."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def require(
    name: str, value: float, at_least: float = -GREATEST, at_most: float = GREATEST
) -> None:
    """Raises InvalidValue unless `value` is a finite number within the bounds.

    Args:
        name: of the value, as in its dataclass.
        value: Python's or NumPy's.
        at_least: by default the least number that float32 has.
        at_most: by default the greatest.
    """
    number = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    known = isinstance(number, numbers.Real) and not isinstance(number, bool)
    if not (known and -GREATEST <= number <= GREATEST):
        raise InvalidValue(name, value, "must be a finite number")
    if not at_least <= number <= at_most:
        if at_least == at_most:
            raise InvalidValue(name, value, f"must be {_text(at_least)}")
        bounds = [f"at least {_text(at_least)}"] * (at_least > -GREATEST)
        bounds += [f"at most {_text(at_most)}"] * (at_most < GREATEST)
        raise InvalidValue(name, value, f"must be {' and '.join(bounds)}")


def require_whole(name: str, value: int, at_least: int = 0, at_most: int = MOST) -> None:
    """Raises InvalidValue unless `value` is a whole number within the bounds."""
    if not is_whole(value):
        raise InvalidValue(name, value, "must be a whole number")
    require(name, value, at_least, at_most)


def require_that(name: str, value: Any, allowed: Callable[[Any], bool], what: str) -> None:
    """Raises InvalidValue unless `value` is a finite number and allowed.

    Args:
        name: of the value, as in its dataclass.
        value: Python's.
        allowed: whether a number is.
        what: is allowed, in words that follow "must be".
    """
    number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    whole = isinstance(value, numbers.Integral)
    if not (number and (whole or math.isfinite(value)) and allowed(value)):
        raise InvalidValue(name, value, f"must be {what}")


def require_up_to(name: str, value: float, most: int, whole: bool = False) -> None:
    """Raises InvalidValue unless `value` is a number from 0 to `most`."""
    if whole and not isinstance(value, numbers.Integral):
        raise InvalidValue(name, value, "must be a whole number")
    require_that(name, value, lambda number: 0 <= number <= most, f"from 0 to {most}")


def require_seeds(first_seed: int, seeds: int) -> None:
    """Raises InvalidValue unless there are so many seeds from `first_seed` on."""
    require_whole("seeds", seeds, at_least=1, at_most=_MOST_SEEDS)
    require_whole("first_seed", first_seed, at_most=MOST_SEED + 1 - int(seeds))


def one_of(name: str, value: str, allowed: Sequence[str]) -> None:
    """Raises InvalidValue unless `value` is one of those that are allowed."""
    if value not in allowed:
        raise InvalidValue(name, value, f"must be one of {', '.join(allowed)}")


def require_default(
    config: T,
    usual: T,
    names: Iterable[str],
    why: str,
    prefix: str = "",
    mentions: tuple[str, ...] = (),
) -> None:
    """Raises InvalidValue where an option is given that nobody would look at.

    Args:
        config: a dataclass.
        usual: the same where no option is given.
        names: of those of its fields that would be ignored.
        why: they have no meaning.
        prefix: before the fields' names, in the message.
        mentions: names of other values that stand in `why`.
    """
    for name in names:
        if getattr(config, name) != getattr(usual, name):
            raise InvalidValue(prefix + name, ..., why, mentions)


def _text(bound: float) -> str:
    return str(bound) if is_whole(bound) else f"{bound:g}"
