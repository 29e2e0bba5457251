"""Whether somebody is there: the page that controls answers the frames that it is shown."""


class Attention:
    """Counts how long frames that were shown wait for an answer; it has no clock of its own.

    Attributes:
        seen: the last frame that was answered.
    """

    MOST_AT_ONCE = 0.1
    """Of a silence [s]: while the program is busy with other things, answers wait unread."""

    def __init__(self, limit: float):
        """Nobody is there yet.

        Args:
            limit: the silence after which nobody is there [s].
        """
        self.limit = limit
        self.begin(0)

    def begin(self, number: int) -> None:
        """Somebody comes: the first frame that is shown to them is this one."""
        self.seen = self._shown = number - 1
        self._silence = 0.0

    def show(self, number: int) -> None:
        """A frame is shown."""
        self._shown = number

    def answer(self, number: int) -> None:
        """A frame was seen, and with it those before.

        Raises:
            ValueError: one line, if it was not shown.
        """
        if not 0 <= number <= self._shown:
            raise ValueError(f"seen: frame {number}: must be from 0 to {self._shown}")
        self.hear(number)

    def hear(self, number: int | None) -> None:
        """Something was said, of a frame that was seen or of none."""
        self._silence = 0.0
        if number is not None:
            self.seen = max(self.seen, min(number, self._shown))

    def is_lost(self, seconds: float) -> bool:
        """Lets time pass; whether the silence has just become too long.

        Args:
            seconds: since the last time.
        """
        before = self._silence
        if self.seen < self._shown:
            self._silence += min(seconds, self.MOST_AT_ONCE)
        return before < self.limit <= self._silence

    def settle(self, number: int) -> None:
        """What was played before a frame has been dealt with."""
        self.seen = max(self.seen, number - 1)
