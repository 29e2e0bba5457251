"""What can go wrong, each in one line that a user can act upon."""


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


class BadInput(Exception):
    """One line that names the option, the value and what is allowed."""


def first_line(error: BaseException) -> str:
    """What an error says first; its type, if it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
