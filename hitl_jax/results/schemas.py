"""What the JSON of a results folder may hold, types and ranges; `json_documents` reads it.

The names are those of the dataclasses that are written. Where a name may be missing, an earlier
commit has written files without it.
"""

from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

Text = Annotated[str, Meta(max_length=10_000)]
"""`json_documents` refuses control characters, which a terminal would obey."""
# No pattern is in a union with numbers: msgspec 0.19 to 0.22 reads wrong memory there, and crashes.

Count = Annotated[int, Meta(ge=0, le=2**53)]
Positive = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Seconds = Annotated[float, Meta(ge=0.0)]
Digest = Annotated[str, Meta(pattern=r"\Asha256:[0-9a-f]{64}\Z")]
Versions = Annotated[dict[Text, Text], Meta(max_length=100)]

Config = dict[Text, Any]
"""What a folder of anybody's experiment was made with; `json_documents` bounds its
depth."""


class _Agent(Struct):
    indicator: Text | UnsetType = UNSET
    danger: Text | UnsetType = UNSET
    boundary_source: Text | UnsetType = UNSET
    action_size: Positive | UnsetType = UNSET


class _Human(Struct):
    tolerance: float | UnsetType = UNSET


class _Hyper(Struct):
    initial_boundary: float | UnsetType = UNSET
    delta_minus: float | UnsetType = UNSET
    delta_plus: float | UnsetType = UNSET
    human: _Human | UnsetType = UNSET


class _Task(Struct):
    env: Text
    solved: Annotated[float, Meta(ge=-1e9, le=1e9)] | UnsetType | None = UNSET
    steps_per_second: Annotated[float, Meta(gt=0.0)] | UnsetType = UNSET


class KnownConfig(Struct):
    """What of a config is used without the whole being that of a sweep."""

    task: _Task | UnsetType = UNSET
    backend: Text | UnsetType = UNSET
    episodes: Positive | UnsetType = UNSET
    test_episodes: Count | UnsetType = UNSET
    alarm_window: Count | UnsetType = UNSET
    human_policy: Digest | UnsetType | None = UNSET
    human: Digest | UnsetType = UNSET
    fitted_human: Digest | UnsetType = UNSET
    agent: _Agent | UnsetType = UNSET
    hyper: _Hyper | UnsetType = UNSET


class ShardOf(Struct, forbid_unknown_fields=True):
    """`hitl_jax.sweep.shards.Shard`."""

    number: Positive
    of: Annotated[int, Meta(ge=1, le=100_000)]
    methods: Annotated[
        list[Annotated[str, Meta(pattern=r"\A[a-z0-9][a-z0-9-]{0,99}\Z")]],
        Meta(min_length=1, max_length=100),
    ]
    first_seed: Annotated[int, Meta(ge=0, le=2**32 - 1)]
    seeds: Annotated[int, Meta(ge=1, le=100_000)]

    def __post_init__(self) -> None:
        """Refuses a shard that is none of its sweep's."""
        if self.number > self.of:
            raise ValueError(f"shard {self.number}/{self.of}: is none of {self.of}")
        if len(self.methods) * self.seeds > 1_000_000:
            raise ValueError(f"{len(self.methods) * self.seeds} runs: must be at most 1000000")
        if len(set(self.methods)) < len(self.methods):
            raise ValueError("a method is there twice")


class FolderDocument(Struct):
    """config.json."""

    config: Config
    command: Annotated[str, Meta(max_length=1_000_000)] | UnsetType = UNSET
    versions: Versions | UnsetType = UNSET
    commit: Text | UnsetType | None = UNSET
    shard: ShardOf | UnsetType = UNSET


class Diverged(Struct, forbid_unknown_fields=True):
    """`hitl_jax.training.run_spec.Divergence`."""

    quantity: Text
    env_steps: Count
    episodes: Count


class RunDocument(Struct):
    """run.json."""

    method: Text
    seed: Annotated[int, Meta(ge=0, le=2**53)]
    config: Config
    versions: Versions
    commit: Text | None
    wall_seconds: Seconds
    env_steps: Count
    updates: Count
    status: Text | UnsetType = UNSET
    machine: Text | UnsetType = UNSET
    diverged: Diverged | UnsetType | None = UNSET
    lost_tests: Count | UnsetType = UNSET
    files: dict[Text, Digest] | UnsetType = UNSET


class MadeBy(Struct):
    """Of a run in a save of any format: by which code and packages it was made."""

    commits: list[Text] = []
    versions: Versions = {}


class SavedFacts(Struct, forbid_unknown_fields=True):
    """A run of a save's head, as `saved_run.facts_of` and `UnderWay.save` tell it."""

    method: Annotated[str, Meta(pattern=r"\A[a-z0-9][a-z0-9-]{0,99}\Z")]
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)]
    setting: Annotated[str, Meta(pattern=r"\A[a-z0-9]{0,99}\Z")]
    ticks: Count
    env_steps: Count
    updates: Count
    seconds: Seconds
    begun: bool
    diverged: tuple[Text, Count, Count] | None
    recordings: dict[Text, tuple[Positive, Positive]]
    snapshots: list[Positive] | UnsetType = UNSET
    commits: list[Text] | UnsetType = UNSET
    versions: Versions | UnsetType = UNSET


class SaveHead(Struct, forbid_unknown_fields=True):
    """The head of a save."""

    format: Count
    runs: list[SavedFacts]
    frames: dict[Annotated[str, Meta(pattern=r"\A[0-9]{1,12}\Z")], dict[Text, Count]]
