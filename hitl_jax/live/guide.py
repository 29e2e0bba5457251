"""A guided session: a person agrees to take part, plays for a while, and answers six questions."""

import pathlib
from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple

from hitl_jax.errors import ResultsError

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
    "While you play, the keys and buttons that you use here and their times are written to a file "
    "on this machine, and so are your answers at the end. You can stop whenever you like, by "
    "closing this page."
)


class GuideOptions(NamedTuple):
    """How a session is guided.

    Attributes:
        consent: what a person agrees to before it begins.
        steps: how long it is [environment steps]; then the questions come.
        asks: whether the walker stops and asks where an alarm begins.
        answer_seconds: how long it waits for an answer [s].
    """

    consent: str
    steps: int
    asks: bool = False
    answer_seconds: float = 5.0


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
        if self._options is not None and kind in ("speed", "step"):
            raise ValueError(f"{kind}: a guided session is played in real time")
        self._said.add(kind)


def agreement(options: GuideOptions) -> dict[str, Any]:
    """The message by which a person agrees to take part, as a journal keeps it."""
    told = options._asdict()
    return {"type": "consent", "text": told.pop("consent"), **told}


def agreed(lines: Iterable[dict[str, Any]]) -> dict[str, Any] | None:
    """What a person agreed to, from a journal's lines; None where nobody was asked."""
    said = (line["said"] for line in lines if "said" in line)
    return next((one for one in said if one["type"] == "consent"), None)


def was_played(lines: Iterable[dict[str, Any]]) -> bool:
    """Whether a journal's session went beyond its first frame."""
    return any(line["at"] > 0 for line in lines)


def require_same(
    path: pathlib.Path, lines: Sequence[dict[str, Any]], options: GuideOptions | None
) -> None:
    """Checks that a journal can be gone on with.

    Args:
        path: of the journal.
        lines: of it.
        options: how the session is guided from now on.

    Raises:
        ResultsError: one line, if it has ended, or was guided otherwise.
    """
    has = agreed(lines)
    if any(line.get("said", {}).get("type") == "questionnaire" for line in lines):
        raise ResultsError(f"{path}: its session has ended: name another journal")
    if was_played(lines) and (has is None) != (options is None):
        guided = "is not guided" if has is None else "is guided"
        raise ResultsError(f"{path}: its session {guided}, asked for otherwise: name another")
    if has is not None and options is not None:
        asked = agreement(options)
        for name in asked:
            if has.get(name) != asked[name]:
                raise ResultsError(
                    f"{path}: its person agreed to {name} {str(has.get(name))[:50]}, asked for "
                    f"{str(asked[name])[:50]}: name another journal"
                )


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
