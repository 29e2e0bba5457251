"""JSON files: what they hold is checked whole against a schema before any of it is used.

Each carries a digest of its own content, so that a file that was damaged is not taken for another
one. Those of format 1 have none: they were written before there was one.
"""

import dataclasses
import hashlib
import json
from typing import Any, TypeVar

import msgspec
import numpy as np

FORMAT = 2
_WITHOUT_DIGEST = 1

_DEEPEST = 12
LARGEST_JSON = 16 * 2**20
"""Of a JSON file [bytes]."""

T = TypeVar("T")


def to_json(document: dict[str, Any]) -> str:
    """A document as text, with its format and its digest.

    Args:
        document: what JSON can hold, no NaN; NumPy's numbers and arrays too.

    Raises:
        ValueError: one line, if it could not be read back.
    """
    whole = {"format": FORMAT, **document}
    require_plain(json.loads(_text(whole)))
    return _text(whole | {"digest": _digest(json.loads(_text(whole)))})


def from_json(data: bytes, schema: Any) -> dict[str, Any]:
    """The document of a text, without its digest.

    Args:
        data: UTF-8.
        schema: a type that msgspec knows; what it does not name is not looked at.

    Raises:
        ValueError: one line saying what is wrong, and where.
    """
    document = plain_from_json(data, dict[str, Any])
    form = document.get("format")
    if form not in (FORMAT, _WITHOUT_DIGEST) or isinstance(form, bool | float):
        raise ValueError(f"is not of format {FORMAT} of this program")
    given = document.pop("digest", None)
    if given != _digest(document) and (given is not None or form == FORMAT):
        raise ValueError("its digest is not that of what it holds")
    checked(document, schema)
    return document


def plain_from_json(data: bytes, schema: Any) -> Any:
    """What a text without format and digest holds.

    Raises:
        ValueError: one line saying what is wrong, and where.
    """
    try:
        document = msgspec.json.decode(data, type=schema)
    except RecursionError:
        raise ValueError("is nested too deep") from None
    except msgspec.MsgspecError as error:  # No ValueError in releases before 0.20.
        raise ValueError(str(error)) from error
    require_plain(document)
    return document


def checked(value: Any, schema: Any) -> Any:
    """A value of plain Python types as one of `schema`.

    Raises:
        ValueError: one line saying what is wrong, and where.
    """
    try:
        return msgspec.convert(value, schema)
    except RecursionError:
        raise ValueError("is nested too deep") from None
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error


def options_of(section: Any, kind: type[T]) -> T:
    """The options that a section was written from.

    Args:
        section: of a document.
        kind: a dataclass.

    Raises:
        ValueError: one line, if a value cannot be, an option is missing, or a name is of none.
    """
    options: T = checked(section, kind)
    _require_names(section, dataclasses.asdict(options))  # type: ignore[call-overload]
    return options


def _require_names(section: dict[str, Any], known: dict[str, Any]) -> None:
    for name in [*known, *section]:
        if name not in section:
            raise ValueError(f"lacks the option {name!r}")
        if name not in known:
            raise ValueError(f"{name[:50]!r}: is no option of this program")
        if isinstance(known[name], dict):
            _require_names(section[name], known[name])


def require_plain(document: Any) -> None:
    """Refuses what is nested too deep, and control characters, which a terminal would obey.

    Raises:
        ValueError: one line.
    """
    level = [document]
    for _ in range(_DEEPEST):
        texts = [value for value in level if isinstance(value, str)]
        groups = [value for value in level if isinstance(value, dict | list)]
        if not all(text.isprintable() for text in texts):
            raise ValueError("holds a text with control characters")
        level = [key for group in groups if isinstance(group, dict) for key in group]
        for group in groups:
            level += group.values() if isinstance(group, dict) else group
        if not level:
            return
    raise ValueError("is nested too deep")


def _text(document: dict[str, Any]) -> str:
    return json.dumps(document, indent=2, allow_nan=False, default=_plain) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} cannot be written as JSON")


def _digest(document: dict[str, Any]) -> str:
    """Of a document without digest, whatever its layout and the order of its keys."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return digest_of(text.encode())


def digest_of(data: bytes) -> str:
    """SHA-256, with the name of it before it."""
    return "sha256:" + hashlib.sha256(data).hexdigest()


def as_in_json(config: dict[str, Any]) -> dict[str, Any]:
    """A config as JSON gives it back: lists for tuples, Python's numbers for NumPy's.

    Raises:
        ValueError: if JSON cannot hold it.
    """
    plain: dict[str, Any] = json.loads(to_json({"config": config}))["config"]
    return plain
