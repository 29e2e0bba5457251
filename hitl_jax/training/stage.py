"""Where a chunk of ticks is played: by the host, tick by tick, or by one program on the device.

Both give the host loop the same: what each tick decided, and what the walkers answered. A stage
holds all that acting remembers.
"""

import dataclasses
from collections.abc import Iterator
from typing import Protocol

import chex
import numpy as np

from hitl_jax.config import RunHyper
from hitl_jax.envs import StepBatch
from hitl_jax.training.batch_arrays import PackedBehavior


@dataclasses.dataclass
class Slots:
    """What the host knows of the R slots at a tick; the host loop changes it as it goes.

    Attributes:
        active: whether a run plays there, bool [R].
        needs_reset: whether its next tick is a reset, bool [R].
        seeds: of the resets to come, the next one first, uint32 [R, K].
        left: episodes that its run has yet to end, int32 [R].
        observation: what was seen last, [R, O].
    """

    active: np.ndarray
    needs_reset: np.ndarray
    seeds: np.ndarray
    left: np.ndarray
    observation: np.ndarray

    @property
    def live(self) -> np.ndarray:
        """Whether a step is taken at this tick, bool [R]."""
        return self.active & ~self.needs_reset


class Tick(Protocol):
    """A tick under way.

    Attributes:
        decided: frames and flags, [R, W + 6]; see `team.packed_decision.act_or_begin`.
    """

    decided: np.ndarray

    def answer(self, live: np.ndarray) -> StepBatch:
        """What the walkers did; those of `live`, bool [R], took a step."""
        ...


class Stage(Protocol):
    """Plays ticks with what acting needs of all runs' parameters.

    Attributes:
        runs_ahead: whether it can play a chunk while the host books the one before.
    """

    runs_ahead: bool

    def prepare(self, parameters: list[PackedBehavior]) -> None:
        """Takes parameters for the next chunk.

        Args:
            parameters: of each learning device. Runs whose parameters are not finite end before it;
                the host ends them before it books.
        """
        ...

    def ticks(self, slots: Slots, count: int) -> Iterator[Tick]:
        """Plays ticks; the host books one before it asks for the next.

        Where the stage `runs_ahead` it begins at once, also if the ticks given before are not
        booked yet; else as the host asks.

        Args:
            slots: as they are before each tick; the host changes them as it books.
            count: how many.
        """
        ...

    def begin_run(self, slot: int, hyper: RunHyper, key: chex.PRNGKey) -> None:
        """Begins a run; as `words` and `restore`, not ahead of what is booked.

        Args:
            slot: where.
            hyper: its hyperparameters, host scalars.
            key: of its acting, see `batch_arrays.run_keys`; consumed.
        """
        ...

    def words(self) -> np.ndarray:
        """All that acting remembers, a row for each slot, uint32 [R, S]."""
        ...

    def restore(self, slot: int, words: np.ndarray) -> None:
        """Puts back a row of `words`, [S], in a slot."""
        ...

    def boundaries(self) -> np.ndarray:
        """The carry of each run's boundary source after what is booked, [R] or [R, K]."""
        ...
