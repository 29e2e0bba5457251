"""A sweep in parts, for machines that know nothing of each other, as the jobs of an array."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

from hitl_jax.errors import InvalidValue
from hitl_jax.results.run_key import RunKey

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

    def places(self, count: int) -> range:
        """Which of so many runs are its: neighbours, so that many are of all methods."""
        first, stop = (count * end // self.of for end in (self.number - 1, self.number))
        return range(first, stop)

    def part(self, runs: Sequence[T]) -> list[T]:
        """Its runs of all."""
        return [runs[place] for place in self.places(len(runs))]

    def runs(self) -> list[RunKey]:
        """The names of its runs: seed after seed, of each all methods."""
        several = len(self.methods)
        places = (divmod(place, several) for place in self.places(several * self.seeds))
        return [RunKey(self.methods[method], self.first_seed + seed) for seed, method in places]


def parse(text: str) -> tuple[int, int]:
    """Number and count of a shard as an option names it, such as `3/16`.

    Raises:
        InvalidValue: one line with the name, the value and what is allowed.
    """
    number, _, of = text.partition("/")
    if number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of):
        return int(number), int(of)
    raise InvalidValue("shard", text, "must be NUMBER/OF, for example 3/16")
