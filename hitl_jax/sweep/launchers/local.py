"""Makes runs in this process."""

import contextlib
import pathlib
from collections.abc import Callable, Collection, Generator, Sequence

from hitl_jax.results.run_key import RunKey
from hitl_jax.sweep.autosave import UnderWay
from hitl_jax.sweep.signals import Interrupted
from hitl_jax.sweep.train_and_test import Batch, Tested, train_and_test
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.run_spec import Run
from hitl_jax.training.saved_run import CannotReturn
from hitl_jax.xla.devices import learning_devices


class Local:
    """One batch after the other; what is under way is saved, and goes on when started again.

    Args:
        folder: of the saves.
        save_seconds: how often runs under way are saved [s].
        finished: the runs that are kept.
        say: prints a line.
    """

    def __init__(
        self,
        folder: pathlib.Path,
        save_seconds: float,
        finished: Callable[[], Collection[RunKey]],
        say: Callable[[str], None],
    ):
        self._folder, self._save_seconds = folder, save_seconds
        self._finished, self._say = finished, say

    def make(
        self, batches: Sequence[Batch], show: Callable[[Sequence[Run]], None]
    ) -> Generator[Tested]:
        """See `Launcher.make`."""
        for batch in batches:
            saves = UnderWay(self._folder / batch.name, batch.loop.frames, self._save_seconds)
            if batch.specs:
                yield from self._make(batch, saves, show)
            else:
                saves.tidy(self._finished(), self._say)

    def _make(
        self, batch: Batch, under_way: UnderWay, show: Callable[[Sequence[Run]], None]
    ) -> Generator[Tested]:
        def watch(rollout: Rollout) -> None:
            show(rollout.runs())
            under_way.watch(rollout)

        devices = learning_devices()
        self._say(
            f"{len(batch.specs)} runs in {batch.slots} slots on {len(devices)} "
            f"{devices[0].platform} devices"
        )
        asked = {spec.key for spec in batch.specs}
        going_on = under_way.take(asked, self._finished(), self._say)
        try:
            with contextlib.closing(train_and_test(batch, watch, going_on)) as made:
                for tested in made:
                    yield tested._replace(
                        commit=under_way.commit_of(tested.key),
                        versions=under_way.versions_of(tested.key),
                    )
        except CannotReturn as error:
            if changed := under_way.changes():
                raise CannotReturn(f"{error}; saved with {'; '.join(changed)}") from error
            raise
        except Interrupted:
            under_way.save()
            raise
        under_way.end()
