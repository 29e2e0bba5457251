"""The messages of a person to a session, as a page sends them and a journal keeps them."""

import json
import math
from collections.abc import Mapping
from typing import Any

from hitl_jax.live.guide import require_answers
from hitl_jax.live.session import Session

SPEEDS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Factors of real time; None is as fast as the machine can."""

PersonMessage = dict[str, Any]
"""`type`, and the fields of that type."""


class _Speed:
    """One of `SPEEDS`, or None."""


_FIELDS: dict[str, dict[str, type]] = {
    "danger": {"down": bool, "frame": int},
    "safe": {"frame": int},
    "take": {"frame": int},
    "let_go": {"frame": int},
    "hands": {"action": list},
    "assist": {"on": bool},
    "undo": {},
    "pause": {"on": bool},
    "step": {},
    "speed": {"factor": _Speed},
    "seen": {"frame": int},
    "consent": {},
    "questionnaire": {"answers": list},
}
_JOURNAL_FIELDS: dict[str, dict[str, type]] = {
    "gone": {"frame": int},
    "no_answer": {"frame": int},
    "consent": {"text": str, "steps": int, "asks": bool, "answer_seconds": float},
}
"""Of messages that the program writes into a journal itself, or with more than a page sends."""

JUDGING = ("danger", "safe", "take", "let_go", "hands", "assist", "undo", "gone")
"""Types that change the session; the others change how fast it is played. `gone` is written where
the page of a person, who saw `frame` last, stopped answering."""


def parse(text: str | bytes) -> PersonMessage:
    """Reads a message that a page sent.

    Args:
        text: JSON, an object.

    Raises:
        ValueError: one line, if it is not one of these messages.
    """
    try:
        said = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError("a message: is not JSON") from error
    if not isinstance(said, dict) or said.get("type") not in list(_FIELDS):
        raise ValueError(f"a message: its type must be one of {', '.join(_FIELDS)}")
    return {"type": said["type"], **_fields(said, _FIELDS[said["type"]])}


def require_known(said: Mapping[str, Any]) -> None:
    """Checks a message of a journal.

    Raises:
        ValueError: one line, if no session writes it.
    """
    known = _FIELDS | _JOURNAL_FIELDS
    if said.get("type") not in list(known):
        raise ValueError(f"its type must be one of {', '.join(known)}")
    if set(said) != {"type", *known[said["type"]]}:
        raise ValueError(f"{said['type']}: its fields must be {', '.join(known[said['type']])}")
    _fields(said, known[said["type"]])


def _fields(said: Mapping[str, Any], wanted: Mapping[str, type]) -> dict[str, Any]:
    fields = {name: _field(said["type"], name, wanted[name], said.get(name)) for name in wanted}
    if said["type"] == "questionnaire":
        require_answers(fields["answers"])
    return fields


def _field(kind: str, name: str, wanted: type, value: Any) -> Any:
    if wanted is _Speed:
        if value is None or (value in SPEEDS and not isinstance(value, bool)):
            return value
        raise ValueError(f"{kind}: factor must be null or one of {', '.join(map(str, SPEEDS))}")
    if wanted is float and _is_number(value):
        return value
    if type(value) is not wanted:
        raise ValueError(f"{kind}: {name} must be of type {wanted.__name__}")
    if isinstance(value, list) and not all(_is_number(one) for one in value):
        raise ValueError(f"{kind}: {name} must be numbers")
    return value


def _is_number(value: Any) -> bool:
    try:
        return type(value) in (int, float) and math.isfinite(value)
    except OverflowError:  # An integer that is too large for a float.
        return False


def apply(session: Session, said: Mapping[str, Any]) -> dict[str, Any]:
    """Makes a session do what a person said.

    Args:
        session: before its next step.
        said: a message of a type in `JUDGING`.

    Returns:
        What the journal keeps with the message: the label that was taken back.

    Raises:
        ValueError: one line, where it cannot be done.
    """
    kind, person = said["type"], session.person
    if kind == "danger":
        person.danger(said["down"], said["frame"])
    elif kind in ("safe", "take", "let_go", "gone"):
        getattr(person, kind)(said["frame"])
    elif kind == "hands":
        person.move(said["action"])
    elif kind == "assist":
        person.assist(said["on"])
    elif kind == "undo":
        label = person.undo()
        return {"label": None if label is None else vars(label)}
    return {}
