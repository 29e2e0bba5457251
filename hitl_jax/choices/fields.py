"""Fields of a configuration, each with its default, bounds and unit at one place.

    @described
    @dataclasses.dataclass(frozen=True)
    class Config:
        gamma: float = number(0.98, at_least=0.0, at_most=1.0)

`require_fields` checks an instance field by field, so that none can be forgotten, and `described`
appends units and choices to the docstring, from which `--help` is made.
"""

import dataclasses
import inspect
import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from hitl_jax.choices.checks import GREATEST, MOST, one_of, require, require_whole
from hitl_jax.choices.registry import Registry
from hitl_jax.errors import InvalidValue, name_of

T = TypeVar("T")

Check = Callable[[str, Any], None]
"""Maps the name of a field and its value to nothing; raises InvalidValue."""

_CHECK, _SAID = "check", "said"


def number(
    default: float,
    at_least: float = -GREATEST,
    at_most: float = GREATEST,
    unit: str = "",
) -> Any:
    """A field that holds a finite number.

    Args:
        default: its value where none is given.
        at_least: least value.
        at_most: greatest value.
        unit: for example `rad`; nothing where it has none.
    """
    return _field(default, lambda name, value: require(name, value, at_least, at_most), _unit(unit))


def whole(default: int, at_least: int = 0, at_most: int = MOST, unit: str = "") -> Any:
    """A field that holds a whole number; see `number`."""
    return _field(
        default, lambda name, value: require_whole(name, value, at_least, at_most), _unit(unit)
    )


def choice(default: str | None, registry: Registry[Any]) -> Any:
    """A field that names a choice: a registered one, or `module:name`."""
    return _field(
        default, lambda name, value: registry.check(value, name), lambda: f" {registry.help}."
    )


def choices(default: tuple[str, ...], registry: Registry[Any]) -> Any:
    """A field that names several choices, each at most once."""

    def check(name: str, value: Any) -> None:
        if not isinstance(value, tuple):
            raise InvalidValue(name, name_of(value), f"must be a tuple: each {registry.allowed}")
        for each in value:
            registry.check(each, name)
        if len(set(value)) < len(value):
            raise InvalidValue(name, " ".join(value), "each at most once")

    return _field(default, check, lambda: f" {registry.help}.")


def among(default: str, allowed: Sequence[str]) -> Any:
    """A field that holds one of some words."""
    return _field(default, lambda name, value: one_of(name, value, tuple(allowed)))


def some_of(allowed: tuple[str, ...]) -> Any:
    """A field that holds some of these words, each at most once; all of them by default."""

    def check(name: str, value: Any) -> None:
        if not isinstance(value, tuple):
            raise InvalidValue(name, name_of(value), f"must be a tuple of {', '.join(allowed)}")
        for each in value:
            one_of(name, each, allowed)
        if len(set(value)) < len(value):
            raise InvalidValue(name, " ".join(value), "each at most once")

    return _field(allowed, check, lambda: f" {', '.join(allowed)}.")


def flag(default: bool) -> Any:
    """A field that is true or false."""
    return _field(default, _require_flag)


def _require_flag(name: str, value: Any) -> None:
    if not isinstance(value, bool | np.bool_):  # "no" is true.
        raise InvalidValue(name, value, "must be True or False")


def checked_by(default: Any, check: Check, unit: str = "") -> Any:
    """A field with a rule of its own."""
    return _field(default, check, _unit(unit))


def nested(make: Callable[[], Any], check: Check) -> Any:
    """A field that holds fields of its own, or numbers by name; `make` gives the default."""
    return dataclasses.field(default_factory=make, metadata={_CHECK: check})


def require_fields(instance: Any, prefix: str = "") -> None:
    """Checks every field of a dataclass.

    Args:
        instance: of a dataclass, all of whose fields are made by the functions above.
        prefix: before the fields' names, in messages.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
        TypeError: for a field that is not made by one of them.
    """
    for field in dataclasses.fields(instance):
        if _CHECK not in field.metadata:
            raise TypeError(f"{type(instance).__name__}.{field.name}: says no bounds")
        field.metadata[_CHECK](prefix + field.name, getattr(instance, field.name))


def described(kind: type[T]) -> type[T]:
    """Appends units and choices of the fields to the docstring's lines on them.

    Args:
        kind: a dataclass with a docstring in Google's style.
    """
    kind.__doc__ = inspect.cleandoc(kind.__doc__ or "")  # As Python 3.13 does.
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        said = field.metadata.get(_SAID)
        if said is not None:
            lines = rf"(\n    {field.name}: (?:.*\n?)(?:        .*\n)*?)(?=    \S|\n|\Z)"
            found = re.search(lines, kind.__doc__)
            if found is not None:
                text = found[1].rstrip().removesuffix(".") + said() + "\n"
                kind.__doc__ = kind.__doc__[: found.start()] + text + kind.__doc__[found.end() :]
    return kind


def _unit(unit: str) -> Callable[[], str]:
    return lambda: f" [{unit}]." if unit else ""


def _field(default: Any, check: Check, said: Callable[[], str] | None = None) -> Any:
    return dataclasses.field(default=default, metadata={_CHECK: check, _SAID: said})
