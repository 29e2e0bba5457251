"""Notices that nobody is there: the page that controls answers each frame that it has shown."""


class SilenceTimer:
    """Counts how long shown frames wait for an answer; the caller tells it how time passes.

    Attributes:
        seen: the last frame that was answered.
    """

    MAX_STEP = 0.1
    """What a call of `advance` adds at most [s]: while the program is busy, answers wait unread."""

    def __init__(self, limit: float):
        """Starts with nobody there.

        Args:
            limit: the silence after which nobody is there [s].
        """
        self.limit = limit
        self.start(0)

    def start(self, number: int) -> None:
        """Starts anew for a page whose first frame is this one."""
        self.seen = self._shown = number - 1
        self._silence = 0.0

    def show(self, number: int) -> None:
        """Notes that a frame is shown."""
        self._shown = number

    def answer(self, number: int) -> None:
        """Notes that a frame was seen, and with it those before.

        Raises:
            ValueError: one line, if it was not shown.
        """
        if not 0 <= number <= self._shown:
            raise ValueError(f"seen: frame {number}: must be from 0 to {self._shown}")
        self.hear(number)

    def hear(self, number: int | None) -> None:
        """Notes any message, about a frame that was seen or about none."""
        self._silence = 0.0
        if number is not None:
            self.seen = max(self.seen, min(number, self._shown))

    def advance(self, seconds: float) -> bool:
        """Adds to the silence, if a frame waits; whether it has just become too long.

        Args:
            seconds: since the last call.
        """
        before = self._silence
        if self.seen < self._shown:
            self._silence += min(seconds, self.MAX_STEP)
        return before < self.limit <= self._silence

    def skip_to(self, number: int) -> None:
        """Expects no answer to the frames before this one."""
        self.seen = max(self.seen, number - 1)
