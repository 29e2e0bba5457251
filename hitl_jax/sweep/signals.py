"""Ctrl-C and SIGTERM, noticed where a run can be saved."""

import contextlib
import signal
from collections.abc import Callable, Iterator


class Interrupted(KeyboardInterrupt):
    """A signal to stop, noticed at a point where nothing is lost.

    Attributes:
        exit_code: what the shell expects of a process that this signal ended.
    """

    def __init__(self, number: int = signal.SIGINT):
        """Keeps which signal it was."""
        super().__init__()
        self.exit_code = 128 + number


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[Callable[[], None]]:
    """Gives a function that raises Interrupted after SIGINT or SIGTERM; a second one ends at once.

    Raised at any instant, KeyboardInterrupt could land where Python drops it.
    """
    noted: list[int] = []

    def note(number: int, _: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        noted.append(number)

    def stop_if_noted() -> None:
        if noted:
            raise Interrupted(noted[0])

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop_if_noted
    finally:
        if not noted:
            for number, handler in previous.items():
                signal.signal(number, handler)
