"""What tyro says of a bad command line, as one line with the option, the value and what is allowed.

tyro frames its message, and leaves out the option where a word is too many, and the value where it
is not of the option's kind: those lines are made here, of the words that were given.
"""

import itertools
import re
from collections.abc import Sequence

_KINDS = {
    "INT": "a whole number",
    "FLOAT": "a number",
    "[INT [INT ...]]": "whole numbers",
    "[STR FLOAT [STR FLOAT ...]]": "pairs of a name and a number",
}
"""What a value must be, by what `--help` shows in its place."""

_TOO_MANY = "Unrecognized options: "
_MISSING = re.compile(r"Missing value for argument .*?(--[\w.-]+)\W*\. Expected")
"""Versions of tyro quote the option in different ways."""


def one_line(box: str, words: Sequence[str]) -> str:
    """The message of tyro's box.

    Args:
        box: as wide as its longest line.
        words: of the command line, behind the command's name.
    """
    lines = [line.removeprefix("│ ").removesuffix("│").strip() for line in box.splitlines()]
    parts = itertools.takewhile(lambda line: set(line) != {"─"}, lines[1:])
    message = " ".join(line for line in parts if line)
    split = [part for word in words for part in _split(word)]
    if message.startswith(_TOO_MANY):
        return _too_many(message, split)
    if missing := _MISSING.match(message):
        return f"{missing[1]}: a value is missing"
    told = re.match(r"Error parsing (--\S+):", message)
    return _of_another_kind(message, told[1], lines, split) if told else message


def _too_many(message: str, words: list[str]) -> str:
    """With the option before the first word that nothing takes, if that is one word of the line."""
    rest = message.removeprefix(_TOO_MANY)
    places = [i for i, word in enumerate(words) if f"{rest}, ".startswith(f"{word}, ")]
    if len(places) != 1 or _is_option(words[places[0]]):
        return message
    place = places[0]
    before = [i for i, word in enumerate(words[:place]) if _is_option(word)]
    if not before:
        return message
    first = before[-1]
    option, word = words[first], words[place]
    alone = first - 1 not in before  # Else tyro may have taken this option as the value of that.
    given = _shown(words[first - (not alone) : place + 1])
    if alone and place == first + 1:
        name = option.removeprefix("--")
        other = name.removeprefix("no-") if name.startswith("no-") else f"no-{name}"
        return f"{given}: takes no value; --{other} is its opposite"
    return f"{given}: {_shown([word])} is a word too many"


def _of_another_kind(message: str, option: str, lines: list[str], words: list[str]) -> str:
    """With the value and what is allowed, if `--help` shows that of the option."""
    shown = [line.removeprefix(option).strip() for line in lines if line.startswith(f"{option} ")]
    kind = shown[0].removeprefix("{None}|") if shown else ""
    places = [i for i, word in enumerate(words) if word == option]
    if kind not in _KINDS or not places:
        return message
    values = list(itertools.takewhile(lambda word: not _is_option(word), words[places[-1] + 1 :]))
    if not kind.startswith("["):
        values = values[:1]
    return f"{_shown([option, *values])}: must be {_KINDS[kind]}"


def _split(word: str) -> list[str]:
    """`--a_b=c` as `--a-b` and `c`; any other word as it is."""
    if not _is_option(word):
        return [word]
    name, sign, value = word.partition("=")
    return [name.replace("_", "-"), *([value] if sign else [])]


def _is_option(word: str) -> bool:
    return word.startswith("--")


def _shown(words: Sequence[str]) -> str:
    """In one line; what is no character of a text is a space."""
    return "".join(c if c.isprintable() else " " for c in " ".join(words))
