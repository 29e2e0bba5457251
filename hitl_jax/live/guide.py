"""A guided session: a person agrees to take part, plays for a while, and answers six questions."""

from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

SCALES = (
    "mental_demand",
    "physical_demand",
    "temporal_demand",
    "performance",
    "effort",
    "frustration",
)
"""What NASA-TLX asks for (Hart and Staveland, 1988), each from 0, little, to 100; of `performance`
100 is failure. Their mean is the workload ("raw TLX", Hart, 2006)."""

MOST, PACE = 100, 5
"""The greatest answer, and the distance between two."""

Stage = Literal["consent", "play", "questions", "end"]

CONSENT = (
    "While you play, the keys that you use here and their times are written to a file on this "
    "machine. You can stop whenever you like, by closing this page."
)


class GuideOptions(NamedTuple):
    """How a session is guided.

    Attributes:
        consent: what a person agrees to before it begins.
        steps: how long it is [environment steps]; then the questions come.
    """

    consent: str
    steps: int


class Guide:
    """What a session waits for; one that is not guided never waits."""

    def __init__(self, options: GuideOptions | None, said: Iterable[str] = ()):
        """Takes the session as it stands.

        Args:
            options: None is not guided.
            said: types of the messages so far.
        """
        self._options, self._said = options, set(said)

    def stage(self, steps: int) -> Stage:
        """What comes next after this many environment steps."""
        if self._options is None:
            return "play"
        if "questionnaire" in self._said:
            return "end"
        if "consent" not in self._said:
            return "consent"
        return "play" if steps < self._options.steps else "questions"

    def hear(self, kind: str, steps: int) -> None:
        """Notes that a message of a type is there.

        Raises:
            ValueError: one line, where it is not asked for.
        """
        stage = self.stage(steps)
        wanted = {"consent": "consent", "questionnaire": "questions"}.get(kind, "play")
        if stage != wanted:
            now = {
                "consent": "the person has not agreed to take part yet",
                "play": "the session is played",
                "questions": "the session is over, the questions come",
                "end": "the session has ended",
            }[stage]
            raise ValueError(f"{kind}: {now}")
        self._said.add(kind)


def require_answers(answers: Sequence[float]) -> None:
    """Checks the answers to the questions.

    Raises:
        ValueError: one line.
    """
    allowed = range(0, MOST + 1, PACE)
    if len(answers) != len(SCALES) or not all(answer in allowed for answer in answers):
        raise ValueError(
            f"questionnaire: answers must be {len(SCALES)} numbers from 0 to {MOST}, "
            f"in steps of {PACE}"
        )
