"""What may be read of a damaged file without being wrong: what we might have written ourselves."""

import csv
import io
import json
import re
from typing import Any

import numpy as np
from damages import kind_of

from hitl_jax.results.config_diff import CAME_LATER, flatten

_OPTIONAL = {"shard", "machine", "diverged", "lost_tests", "status", "command", "made", "time"}
_OPTIONAL |= {"label", "versions", "commit", "processor"}
_OPTIONAL |= {name.rpartition(".")[2] for name in flatten(CAME_LATER)}


_NUMBER = re.compile(r"(-?\d+(\.\d+)?(e[+-]?\d+)?|nan)?", re.ASCII)


def never(before: bytes, now: bytes) -> bool:
    """Of what has a checksum."""
    return False


def like_json(before: bytes, now: bytes) -> bool:
    """Whether two documents have the same kinds of values in the same places."""

    def refuse(constant: str) -> None:
        raise ValueError(constant)

    return _alike(json.loads(before), json.loads(now, parse_constant=refuse))


def _alike(before: Any, now: Any) -> bool:
    if isinstance(before, dict) and isinstance(now, dict):
        same = all(
            _alike(before[name], now[name])
            or name == "versions"
            or (name == "commit" and now[name] is None)
            for name in before
            if name in now
        )
        return same and set(before) - set(now) <= _OPTIONAL
    if isinstance(before, list) and isinstance(now, list):
        kinds = {kind_of(one) for one in before}
        return {kind_of(one) for one in now} <= kinds
    if isinstance(now, str) and not now.isprintable():
        return False
    return kind_of(before) == kind_of(now)


def like_signed_json(before: bytes, now: bytes) -> bool:
    """Likewise, of a document whose digest is right: somebody has written it on purpose."""
    return "digest" in json.loads(now) and like_json(before, now)


def like_lines(before: bytes, now: bytes) -> bool:
    """Whether each line is like one that was there, and the chunks follow each other."""
    kinds: dict[str, Any] = {}
    for line in before.splitlines():
        kinds.setdefault(_kind_of_line(json.loads(line)), line)
    for line in now.split(b"\n")[:-1]:
        kind = _kind_of_line(json.loads(line))
        if kind not in kinds or not like_json(kinds[kind], line):
            return False
    return True


def _kind_of_line(line: dict[str, Any]) -> str:
    return str(line["said"].get("type")) if "said" in line else str(sorted(line))


def like_csv(before: bytes, now: bytes) -> bool:
    """Whether a file has the same columns, and numbers where there were numbers."""
    (head, *rows), (head_now, *rows_now) = (
        list(csv.reader(io.StringIO(data.decode()))) for data in (before, now)
    )
    numeric = [all(_NUMBER.fullmatch(row[place]) for row in rows) for place in range(len(head))]
    return (
        head == head_now
        and now.endswith(b"\n")
        and all(len(row) == len(head) for row in rows_now)
        and all(
            _NUMBER.fullmatch(cell) if number else cell.isprintable()
            for row in rows_now
            for number, cell in zip(numeric, row, strict=True)
        )
    )


def like_arrays(before: bytes, now: bytes) -> bool:
    """Whether the arrays have the same names, shapes and types, and are finite."""
    with np.load(io.BytesIO(before)) as old, np.load(io.BytesIO(now)) as new:
        # A run may have recorded nothing.
        return not new.files or (
            old.files == new.files
            and all(
                (old[name].shape, old[name].dtype) == (new[name].shape, new[name].dtype)
                and np.isfinite(new[name]).all()
                for name in old.files
            )
        )


def like_judgements(before: bytes, now: bytes) -> bool:
    """Whether it is one row of yes and no."""
    with np.load(io.BytesIO(now)) as new:
        return new.files == ["dangerous"] and str(new["dangerous"].dtype) == "bool"


def like_an_actor(before: bytes, now: bytes) -> bool:
    """Whether the arrays of the actor are as they were, whatever else there is."""
    with np.load(io.BytesIO(before)) as old, np.load(io.BytesIO(now)) as new:
        own = [name for name in old.files if name.startswith("actor/")]
        return all(
            name in new.files
            and new[name].dtype == np.float32
            and (len(own) > 4 or new[name].shape == old[name].shape)
            for name in own
        )


def like_a_save(before: bytes, now: bytes) -> bool:
    """Whether a save that somebody signed has the arrays and the head of one."""
    with np.load(io.BytesIO(before[:-16])) as old, np.load(io.BytesIO(now[:-16])) as new:
        if not set(old.files) <= set(new.files):
            return False
        same = all(
            old[name].dtype.kind == new[name].dtype.kind
            for name in old.files
            if not name.endswith("boundaries")
        )
        if "head" not in old.files:
            return same
        return same and like_json(old["head"].tobytes(), new["head"].tobytes())
