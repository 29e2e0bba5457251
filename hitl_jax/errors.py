"""What can go wrong, each in one line that a user can act upon."""

import re
from collections.abc import Callable


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
