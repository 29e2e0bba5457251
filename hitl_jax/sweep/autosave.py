"""Runs that are trained side by side, saved now and then, so that what is stopped can go on."""

import pathlib
import time
from collections.abc import Callable, Collection
from typing import Any

from hitl_jax.errors import ResultsError
from hitl_jax.results.config_diff import changes, joined
from hitl_jax.results.provenance import git_commit, versions
from hitl_jax.results.run_key import RunKey
from hitl_jax.training.rollout import Rollout
from hitl_jax.training.saved_run import SavedRun
from hitl_jax.training.saved_run_store import Saves

SAVE_SECONDS = 120.0
"""How often runs are saved [s]: what a killed process loses at most."""


class UnderWay:
    """A folder of saves and the rollout that is saved there.

    Args:
        path: the folder, there or not.
        capacity: frames that a run's replay holds.
        seconds: how often runs are saved [s].
    """

    def __init__(self, path: pathlib.Path, capacity: int, seconds: float = SAVE_SECONDS):
        self._saves = Saves(path, capacity)
        self._seconds = seconds
        self._rollout: Rollout | None = None
        self._left_alone: list[SavedRun] = []
        self._earlier: dict[RunKey, dict[str, Any]] = {}
        # Of the code that is loaded.
        self._commit, self._versions = git_commit() or "unknown", versions()
        self._save_at = time.monotonic() + seconds

    def take(
        self, asked: Collection[RunKey], finished: Collection[RunKey], say: Callable[[str], None]
    ) -> dict[RunKey, SavedRun]:
        """Reads what was saved.

        Args:
            asked: the runs that are wanted.
            finished: the runs that need not go on.
            say: is told what was found.

        Returns:
            The wanted runs that were saved. Other commands may need the runs that were not asked
            for: they stay in the folder.

        Raises:
            ResultsError: if there are saves, and none can be read.
        """
        saved, notes = self._saves.load()
        self._earlier = {key: run.facts for key, run in saved.items()}
        for note in notes:
            say(f"a save cannot be used: {note}")
        others = saved.keys() - set(asked) - set(finished)
        self._left_alone = [saved[key].without_new_frames() for key in sorted(others)]
        going_on = {key: run for key, run in saved.items() if key in asked}
        if going_on:
            say(f"{len(going_on)} runs go on where they were saved")
        return going_on

    def watch(self, rollout: Rollout) -> None:
        """To be called after each chunk; saves if it is time to.

        Raises:
            ResultsError: if the disk refuses.
        """
        self._rollout = rollout
        if time.monotonic() >= self._save_at:
            self.save()

    def save(self) -> None:
        """Writes all that the runs need to go on; those that have finished meanwhile as well.

        Raises:
            ResultsError: if the disk refuses; the save before still counts.
        """
        if self._rollout is not None:
            runs = [
                run._replace(
                    facts=run.facts
                    | {"commits": self._commits(run.key), "versions": self.versions_of(run.key)}
                )
                for run in self._rollout.save()
            ]
            self._saves.write([*runs, *self._left_alone])
            self._save_at = time.monotonic() + self._seconds

    def commit_of(self, key: RunKey) -> str:
        """The code that a run was trained by; more than one commit if it was changed meanwhile."""
        return "+".join(self._commits(key))

    def versions_of(self, key: RunKey) -> dict[str, str]:
        """What a run was trained with, by package; all versions, if they were changed meanwhile."""
        return joined(self._earlier.get(key, {}).get("versions", {}), self._versions)

    def changes(self) -> list[str]:
        """What of versions is not as it was when runs were saved, a few words each."""
        now = {"versions": self._versions}
        every = [line for facts in self._earlier.values() for line in changes(facts, now)]
        return list(dict.fromkeys(every))

    def _commits(self, key: RunKey) -> list[str]:
        before = self._earlier.get(key, {}).get("commits", [])
        return list(dict.fromkeys([*before, self._commit]))

    def end(self) -> None:
        """Removes the folder when all has finished, but for runs that other commands may need."""
        if not self._left_alone:
            self._saves.remove()

    def tidy(self, finished: Collection[RunKey], say: Callable[[str], None]) -> None:
        """Removes what a command that was killed after its last run has left.

        Args:
            finished: the runs that need not go on.
            say: is told what cannot be read, which stays.
        """
        try:
            self.take((), finished, say)
        except ResultsError as error:
            say(str(error))
        else:
            self.end()
