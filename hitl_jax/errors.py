"""What can go wrong, each in one line that a user can act upon."""

import contextlib
import re
import signal
import traceback
from collections.abc import Callable, Iterator


class InvalidValue(ValueError):
    """A value that is not allowed: `gamma 1.5: must be at most 1`.

    Attributes:
        name: of the value, as in its dataclass; a human parameter is `human.tolerance`.
        value: what was given; `...` where the name says enough.
        why: what is allowed, or what is wrong with it.
        mentions: names of other values that stand in `why`.
    """

    def __init__(self, name: str, value: object, why: str, mentions: tuple[str, ...] = ()):
        """Makes an error of it."""
        super().__init__(name, value, why, mentions)
        self.name, self.value, self.why, self.mentions = name, value, why, mentions

    def __str__(self) -> str:
        return self.text(str)

    def text(self, spell: Callable[[str], str]) -> str:
        """The line, with each value's name as `spell` writes it."""
        why = self.why
        for name in self.mentions:
            why = re.sub(rf"\b{re.escape(name)}\b", spell(name), why)
        value = "" if self.value is ... else f" {self.value}"
        return f"{spell(self.name)}{value}: {why}"


class ResultsError(ValueError):
    """Results that cannot be used; the message is one line naming the file."""


class WalkerError(RuntimeError):
    """A worker raised, died, or did not come up; one line, and the worker's log as a note."""


class Unplayable(ValueError):
    """An environment that a pool cannot play.

    Attributes:
        why: without the environment's name, in one line.
    """

    def __init__(self, env_id: str, why: str):
        """Makes one line of it.

        Args:
            env_id: of the environment.
            why: what is not allowed, and what is.
        """
        self.why = " ".join(why.split())
        super().__init__(f"env_id {env_id!r}: {self.why}")


class LaunchError(Exception):
    """What went wrong on other machines, in one line."""


def first_line(error: BaseException) -> str:
    """What an error says first; its type, if it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def said_by(error: BaseException) -> str:
    """An error's type, and what it says first."""
    kind, text = type(error).__name__, first_line(error)
    return kind if text == kind else f"{kind}: {text}"


def name_of(value: object) -> str:
    """A few words for a value in messages, without all that an object holds."""
    name = getattr(value, "__qualname__", None)
    if isinstance(name, str):
        return name
    kind = type(value).__name__
    plain = isinstance(value, bool | int | float | str | bytes)
    return f"{kind} {value!r}"[:100] if plain else kind


def is_told_to_end(error: BaseException) -> bool:
    """Whether an error was raised by the handler of a signal, wherever that came."""
    handlers = [signal.getsignal(number) for number in signal.valid_signals()]
    codes = {getattr(handler, "__code__", None) for handler in handlers}
    frames = traceback.walk_tb(error.__traceback__)
    return any(frame.f_code in codes for frame, _ in frames)


@contextlib.contextmanager
def blamed_on(
    name: str, value: str, passes: tuple[type[BaseException], ...] = ()
) -> Iterator[None]:
    """Makes one line of whatever a user's own code raises within a `with`.

    Args:
        name: of the value that brought the code.
        value: as messages name it.
        passes: errors that go through as they are.

    Raises:
        InvalidValue: with the error's type and text.
    """
    try:
        yield
    except (InvalidValue, ResultsError, WalkerError, LaunchError):
        raise  # It is one line already.
    except passes:
        raise
    except (Exception, SystemExit) as error:  # Code that exits would end the command unexplained.
        if is_told_to_end(error):
            raise
        raise InvalidValue(name, value, f"raised {said_by(error)}") from error
