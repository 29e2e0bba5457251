"""A sweep in parts, for machines that know nothing of each other, as the jobs of an array."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

from hitl_jax.run_key import RunKey

T = TypeVar("T")


class Shard(NamedTuple):
    """One part of a sweep.

    Attributes:
        number: counted from 1.
        of: how many there are.
        methods: of the whole sweep.
        first_seed: of the whole sweep.
        seeds: of the whole sweep, for each method.
    """

    number: int
    of: int
    methods: list[str]
    first_seed: int
    seeds: int

    @property
    def whole(self) -> dict[str, Any]:
        """What all shards of a sweep have in common."""
        return {name: value for name, value in self._asdict().items() if name != "number"}

    def part(self, runs: Sequence[T]) -> list[T]:
        """Its runs: neighbours, so that each shard has runs of all methods where it has many."""
        first, stop = (len(runs) * end // self.of for end in (self.number - 1, self.number))
        return list(runs[first:stop])

    def runs(self) -> list[RunKey]:
        """The names of its runs."""
        seeds = range(self.first_seed, self.first_seed + self.seeds)
        return self.part([RunKey(method, seed) for seed in seeds for method in self.methods])


def parse(text: str) -> tuple[int, int]:
    """Number and count of a shard as an option names it, such as `3/16`.

    Raises:
        ValueError: one line with the option, the value and what is allowed.
    """
    number, _, of = text.partition("/")
    if number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of):
        return int(number), int(of)
    raise ValueError(f"--shard {text}: must be NUMBER/OF, for example 3/16")
