"""Damages every kind of file that we read, and looks at what becomes of it.

    python tests/attacks/damage.py --seed 0 --damages 10000

A damaged file must be refused in one line, or be read as what it was; without a checksum it may
also be read as another file that we might have written. Anything else is told with its number, by
which `--only` does it again.
"""

import argparse
import dataclasses
import pathlib
import random
import resource
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

sys.path += [str(pathlib.Path(__file__).parents[1]), str(pathlib.Path(__file__).parents[2])]

import numpy as np
from formats import FORMATS, Format
from made_files import make

_SLOW = 10.0
_LONGEST_LINE = 1500
_MEMORY = 6 * 2**30


def attack(root: pathlib.Path, whole: Mapping[str, Any], seed: int, number: int) -> tuple[str, str]:
    """Damages a file, reads it, and puts it back.

    Args:
        root: the folder of `make`.
        whole: what each format is read as, undamaged, by name; of `read_all`.
        seed: of the attack.
        number: of the damage; with the seed, all that it depends on.

    Returns:
        `refused`, `as it was`, `another`, or what is wrong: `traceback`, `wrong accept`, `no line`,
        `slow`; and what was done.
    """
    chance = random.Random(f"{seed} {number}")
    form: Format = FORMATS[number % len(FORMATS)]
    damage = chance.choice(form.damages)
    path = root / form.path
    before = path.read_bytes()
    now = damage(before, chance)
    path.write_bytes(now)
    began = time.monotonic()
    told = f"{form.name}: {damage.__name__}"
    try:
        verdict, told = _read(form, root, whole[form.name], (before, now), told)
    finally:
        path.write_bytes(before)
    slow = time.monotonic() - began > _SLOW
    return ("slow" if slow else verdict), told


def _read(
    form: Format, root: pathlib.Path, whole: Any, data: tuple[bytes, bytes], told: str
) -> tuple[str, str]:
    try:
        found = plain(form.read(root))
    except ValueError as error:
        line = str(error)
        if line.isprintable() and len(line) <= _LONGEST_LINE and type(error).__name__ in _LINES:
            return "refused", told
        return "no line", f"{told}: {type(error).__name__}: {line[:300]!r}"
    except BaseException:
        return "traceback", f"{told}\n{traceback.format_exc()[-2500:]}"
    if found == whole:
        return "as it was", told
    try:
        another = form.could_be(*data)
    except Exception as error:
        return "wrong accept", f"{told}: {error!r}"
    return ("another" if another else "wrong accept"), told


_LINES = ("ResultsError", "ValueError", "InvalidValue", "ConfigMismatch", "CannotReturn")
"""What commands turn into one line."""


def plain(value: Any) -> Any:
    """What was read as something that can be compared, NaN with itself too."""
    if isinstance(value, np.ndarray | np.generic) or hasattr(value, "__array__"):
        array = np.asarray(value)
        return array.shape, str(array.dtype), array.tobytes()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__, plain(vars(value))
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [plain(one) for one in value]
    return repr(value)


def read_all(root: pathlib.Path) -> dict[str, Any]:
    """What each format is read as, by name."""
    return {form.name: plain(form.read(root)) for form in FORMATS}


def main() -> int:
    """Damages as many files as asked for; the exit code, 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--damages", type=int, default=10_000)
    parser.add_argument("--only", type=int, help="the number of one damage")
    options = parser.parse_args()
    numbers = range(options.damages) if options.only is None else [options.only]
    verdicts: Counter[str] = Counter()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        make(root)
        whole = read_all(root)
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY + _size(), hard))
        for number in numbers:
            verdict, told = attack(root, whole, options.seed, number)
            verdicts[verdict] += 1
            if verdict not in ("refused", "as it was", "another"):
                wrong += 1
                print(f"{verdict}: --seed {options.seed} --only {number}: {told}", flush=True)
            if number % 1000 == 999:
                print(f"{number + 1:,} of {len(numbers):,}: {dict(verdicts)}", flush=True)
    what = f"{len(numbers):,} damages of {len(FORMATS)} formats"
    print(f"seed {options.seed}: {what}: {dict(verdicts)}")
    return 1 if wrong else 0


def _size() -> int:
    """Address space that this process has now [bytes]."""
    pages = int(pathlib.Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()


if __name__ == "__main__":
    sys.exit(main())
