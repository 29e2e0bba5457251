"""Choices by name: one registry for each kind, in the room where the kind is implemented.

A choice is given in one of three ways: by a registered name, as an object from Python, or as
`module:name`, which is imported when it is first asked for. What is behind the name is the choice
itself or a function that makes it. Strings alone stand in a configuration; nothing is imported for
them until a team is made, or options are checked for one.
"""

import importlib
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from types import ModuleType
from typing import Any, Generic, NamedTuple, TypeVar

from hitl_jax.errors import InvalidValue, ResultsError, blamed_on, is_told_to_end, name_of, said_by

T = TypeVar("T")

TRUSTED = "HITL_JAX_MODULES"
"""Environment variable: modules that a results folder or a journal may name, between commas."""

_LONGEST = 100
"""Of a name from somebody else's file in a message."""

_IMPORTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
_NAME = re.compile(r"\w[\w.+-]*")
_REGISTRIES: "list[Registry[Any]]" = []


class Entry(NamedTuple):
    """A registered choice.

    Attributes:
        doc: a few words for `--help`, without a full stop.
        value: the choice, or a function that makes it.
    """

    doc: str
    value: Any


class Registry(Mapping[str, Entry], Generic[T]):
    """The choices of one kind, by name, in the order in which they were registered.

    Attributes:
        kind: what they are, as messages name it.
        option: name of the option by which one is chosen.
    """

    def __init__(
        self,
        kind: str,
        option: str,
        fits: Callable[[Any], bool],
        made_once: bool = True,
        require: Callable[[T], Any] = lambda value: None,
        passes: tuple[type[Exception], ...] = (),
    ):
        """Begins without entries.

        Args:
            kind: what they are, as messages name it, for example `boundary source`.
            option: name of the option by which one is chosen, for example `boundary_source`.
            fits: whether an object is one of this kind.
            made_once: whether a name gives the same object each time, for equal arguments. Programs
                are compiled once for a team of equal parts, which must therefore be hashable.
            require: raises ValueError, one line, for one of this kind that cannot be used.
            passes: what the registered functions raise that is one line already.
        """
        self.kind, self.option = kind, option
        self._fits, self._require, self._passes = fits, require, passes
        self._made: dict[Any, T] | None = {} if made_once else None
        self._entries: dict[str, Entry] = {}
        _REGISTRIES.append(self)

    def register(self, name: str, doc: str) -> Callable[[Any], Any]:
        """A decorator that registers a choice, or a function that makes it.

        Args:
            name: by which it is chosen.
            doc: a few words for `--help`, without a full stop.

        Raises:
            ValueError: if the name is taken, or is none that can be written in a command.
        """
        if not (isinstance(name, str) and _NAME.fullmatch(name)):
            raise ValueError(f"{self.kind} {name!r}: must be letters, digits, _, -, + and .")
        if name in self._entries:
            raise ValueError(f"{self.kind} {name}: is registered already")

        def add(value: Any) -> Any:
            self._entries[name] = Entry(doc, value)
            return value

        return add

    def __getitem__(self, name: str) -> Entry:
        return self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        return tuple(self._entries)

    @property
    def help(self) -> str:
        """All names with their docs, and what else can be given, for `--help`."""
        named = [f"`{name}` ({entry.doc})" for name, entry in self._entries.items()]
        return f"{', '.join(named)}, or one of your own as `module:name`"

    @property
    def allowed(self) -> str:
        """What can be chosen, for messages."""
        return f"must be one of {', '.join(self._entries)}, or module:name of your own"

    def check(self, choice: Any, option: str | None = None) -> None:
        """Checks what a configuration names; imports nothing.

        Args:
            choice: what was chosen.
            option: by which; this registry's by default.

        Raises:
            InvalidValue: one line with the option, the value and what is allowed.
        """
        known = isinstance(choice, str) and (choice in self._entries or is_imported(choice))
        if not known:
            told = choice if isinstance(choice, str) else name_of(choice)
            raise InvalidValue(option or self.option, told, self.allowed)

    def make(self, choice: Any, *args: Any, **named: Any) -> T:
        """The choice itself.

        Args:
            choice: a registered name, `module:name`, or an object: the choice, or a function that
                makes it.
            *args: what a function that makes one of this kind is called with.
            **named: likewise.

        Raises:
            InvalidValue: one line with the option, the value and what is allowed.
        """
        if not isinstance(choice, str):
            return self._from(choice, name_of(choice), args, named)
        self.check(choice)
        asked = choice, args, tuple(named.items())
        if self._made is None or asked not in self._made:
            entry = self._entries.get(choice)
            value = self._imported(choice) if entry is None else entry.value
            passes = () if entry is None else self._passes
            made = self._from(value, choice, args, named, passes)
            if self._made is None:
                return made
            self._made[asked] = made
        return self._made[asked]

    def value_of(self, choice: str) -> Any:
        """What stands behind a name, the choice or what makes it; imports what is not registered.

        Raises:
            InvalidValue: one line, if there is nothing of this name.
        """
        self.check(choice)
        entry = self._entries.get(choice)
        return self._imported(choice) if entry is None else entry.value

    def _from(
        self,
        value: Any,
        told: str,
        args: Any,
        named: Any,
        passes: tuple[type[Exception], ...] = (),
    ) -> T:
        """What a value is, or makes; `told` is its name in messages."""
        with blamed_on(self.option, told, passes):
            makes = callable(value) and not self._is_one(value)
            if makes:
                value = value(*args, **named)
            if not self._is_one(value):
                article = "an" if self.kind[0] in "aeiou" else "a"
                why = f"must give {article} {self.kind}, gives {name_of(value)}"
                raise InvalidValue(self.option, told, why if makes else self.allowed)
        one: T = value
        self.require(one, told)
        return one

    def require(self, one: T, told: str, option: str | None = None) -> None:
        """Checks one of this kind.

        Args:
            one: of this kind.
            told: its name in messages.
            option: by which it was chosen; this registry's by default.

        Raises:
            InvalidValue: one line, if it cannot be used.
        """
        with blamed_on(option or self.option, told):
            try:
                self._require(one)
            except ValueError as error:
                raise InvalidValue(option or self.option, told, str(error)) from error
            if self._made is not None and not _is_hashable(one):
                why = "must be hashable, as a frozen dataclass is"
                raise InvalidValue(option or self.option, told, why)

    def _is_one(self, value: Any) -> bool:
        return not isinstance(value, type) and self._fits(value)

    def _imported(self, choice: str) -> Any:
        module, _, name = choice.partition(":")
        try:
            found = _import(module)
        except (Exception, SystemExit) as error:  # Whatever a module does when it is imported.
            if is_told_to_end(error):
                raise
            why = f"{module} cannot be imported: {said_by(error)}"
            raise InvalidValue(self.option, choice, why) from error
        with blamed_on(self.option, choice):  # A module can have a `__getattr__` of its own.
            if not hasattr(found, name):
                raise InvalidValue(self.option, choice, f"{module} has no {name}")
            return getattr(found, name)


def _import(module: str) -> ModuleType:
    """Imports a module that a user names.

    Where that fails, nothing that it registered stays: it will be run again when it is asked for
    again, and then the names must be free.
    """
    before = [(registry, dict(registry._entries)) for registry in _REGISTRIES]
    try:
        return _found(module)
    except BaseException:
        for registry, entries in before:
            registry._entries = entries
        raise


def _found(module: str) -> ModuleType:
    """Imports a module, from the current folder too if it is nowhere else.

    `hitl-jax` does not look there by itself: of a folder that somebody sent, no file must run.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0] or os.getcwd() in sys.path:
            raise
        sys.path.append(os.getcwd())
        importlib.invalidate_caches()
        return importlib.import_module(module)


def _is_hashable(value: Any) -> bool:
    """Whether a value is, with all that it holds."""
    try:
        hash(value)
    except TypeError:
        return False
    return True


def is_imported(choice: Any) -> bool:
    """Whether a choice is `module:name`, code of the user's own."""
    return isinstance(choice, str) and _IMPORTED.fullmatch(choice) is not None


def names_code(choice: Any) -> bool:
    """Whether a name makes a module be imported: `module:name`, whatever letters either has."""
    return isinstance(choice, str) and ":" in choice


def require_trusted(source: object, values: Mapping[str, Any]) -> None:
    """Refuses code that somebody else's file names; to be called before a team is made of a file.

    Args:
        source: the file, for the message.
        values: all that the file names, by option; of tuples each part.

    Raises:
        ResultsError: one line with all that is `module:name` of a module that the environment
            variable `HITL_JAX_MODULES`, names between commas, does not list.
    """
    trusted = [name for each in os.environ.get(TRUSTED, "").split(",") if (name := each.strip())]
    named: dict[str, str] = {}
    for option, value in values.items():
        for choice in value if isinstance(value, tuple) else (value,):
            if names_code(choice) and (module := choice.partition(":")[0]) not in trusted:
                named[f"{option} {choice[:_LONGEST]}"] = module[:_LONGEST]
    if named:
        new = list(dict.fromkeys(named.values()))
        raise ResultsError(
            f"{source}: names code that would be run: {', '.join(named)}; if you trust it, add "
            f"{' and '.join(new)} to {TRUSTED}: {TRUSTED}={','.join([*trusted, *new])}"
        )


def having(*names: str) -> Callable[[Any], bool]:
    """Whether an object has all these attributes: fits what implements a protocol.

    Args:
        *names: of the attributes.
    """
    return lambda value: all(hasattr(value, name) for name in names)
