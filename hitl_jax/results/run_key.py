"""The name of a run."""

import dataclasses
import re
from collections.abc import Iterable

from hitl_jax.results.episode_tables import METHODS


@dataclasses.dataclass(frozen=True, order=True)
class RunKey:
    """The name of a run: its randomness comes from method and seed alone.

    Attributes:
        method: lower-case letters, digits and hyphens, for example "hitl-ac".
        seed: from 0.
        setting: lower-case letters and digits, which tell runs of different settings apart where
            such are trained side by side; else empty.
    """

    method: str
    seed: int
    setting: str = ""

    def __post_init__(self) -> None:
        """Refuses what could not be a file name."""
        if not re.fullmatch(r"[a-z0-9][a-z0-9-]*", self.method) or self.seed < 0:
            raise ValueError(f"run {self.method!r} seed {self.seed}: not a method and a seed >= 0")
        if not re.fullmatch(r"[a-z0-9]*", self.setting):
            raise ValueError(f"setting {self.setting!r}: must be lower-case letters and digits")

    def __str__(self) -> str:
        return f"{self.method} seed {self.seed} {self.setting}".rstrip()

    @property
    def file_name(self) -> str:
        """For example "hitl-ac-seed-0003", with the setting behind it if there is one."""
        return f"{self.method}-seed-{self.seed:04d}" + f"-{self.setting}" * bool(self.setting)


def parse_key(file_name: str) -> RunKey | None:
    """The run of a `RunKey.file_name` without setting; None of another name."""
    match = re.fullmatch(r"([a-z0-9][a-z0-9-]*)-seed-([0-9]{4,})", file_name)
    key = RunKey(match[1], int(match[2])) if match else None
    return key if key and key.file_name == file_name else None


def sort_keys(keys: Iterable[RunKey]) -> list[RunKey]:
    """Runs in the order of `METHODS`, other methods after them by name, then by seed."""
    place = {method: index for index, method in enumerate(METHODS)}
    return sorted(keys, key=lambda key: (place.get(key.method, len(place)), key))
