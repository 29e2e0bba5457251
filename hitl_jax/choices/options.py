"""Numbers that a choice brings: what they are called, and which values they can have."""

import numbers
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from hitl_jax.choices.checks import GREATEST, require
from hitl_jax.errors import InvalidValue, name_of


class Option(NamedTuple):
    """A traced number of a choice's own, in `Hyper.extra`, or in `HumanParams.extra` of a human.

    Attributes:
        name: by which it is found there.
        default: where it is not given.
        doc: what it means, in a few words.
        unit: for example `rad`; nothing where it has none.
        at_least: least value.
        at_most: greatest value.
    """

    name: str
    default: float
    doc: str
    unit: str = ""
    at_least: float = -GREATEST
    at_most: float = GREATEST


def options_of(choice: Any) -> tuple[Option, ...]:
    """The options of a choice, checked; none where it has no attribute `options`.

    Raises:
        InvalidValue: one line, for options that are none, or whose default is not allowed.
    """
    options = getattr(choice, "options", ())
    if not isinstance(options, tuple) or not all(isinstance(each, Option) for each in options):
        raise InvalidValue("options", name_of(options), f"must be a tuple of {Option.__qualname__}")
    for option in options:
        _require_option(option)
    return options


def _require_option(option: Option) -> None:
    name = option.name
    if not (isinstance(name, str) and name.isidentifier()):
        raise InvalidValue("name of an option", name_of(name), "must be a word, as `drift`")
    for what in ("doc", "unit"):
        if not isinstance(getattr(option, what), str):
            raise InvalidValue(f"{what} of option {name}", ..., "must be text")
    for what in ("at_least", "at_most"):
        bound = getattr(option, what)
        if not isinstance(bound, numbers.Real) or bound != bound:
            raise InvalidValue(f"{what} of option {name}", name_of(bound), "must be a number")
    require(f"default of option {name}", option.default, option.at_least, option.at_most)


def all_options(parts: Iterable[Any]) -> dict[str, Option]:
    """All options of some choices, by name.

    Args:
        parts: choices; those without an attribute `options` have none.

    Raises:
        InvalidValue: if two of them bring different options of one name; or see `options_of`.
    """
    found: dict[str, Option] = {}
    for part in parts:
        for option in options_of(part):
            if found.setdefault(option.name, option) != option:
                raise InvalidValue("extra", option.name, "two choices have an option of this name")
    return found


def completed(given: Mapping[str, Any], options: Mapping[str, Option]) -> dict[str, Any]:
    """What was given, and the defaults of what was not; nothing is checked.

    Args:
        given: numbers by name, on the host or traced.
        options: of `all_options`.
    """
    return {name: option.default for name, option in options.items()} | dict(given)


def require_known(
    given: Mapping[str, Any], options: Mapping[str, Option], name: str = "extra"
) -> None:
    """Checks host numbers by the names and bounds of their options.

    Args:
        given: numbers by name; what is missing has its default.
        options: of `all_options`.
        name: of the field that holds them, for the message.

    Raises:
        InvalidValue: one line with the option, the value and what is allowed.
    """
    for key, value in given.items():
        if key not in options:
            allowed = f"must be one of {', '.join(options)}" if options else "no choice has options"
            raise InvalidValue(name, key, allowed)
        require(f"{name}.{key}", value, options[key].at_least, options[key].at_most)


def require_names(name: str, given: Mapping[str, Any]) -> None:
    """Checks what can be checked without the choices: names of options, and finite numbers."""
    for key, value in given.items():
        require(f"{name}.{key}", value)
