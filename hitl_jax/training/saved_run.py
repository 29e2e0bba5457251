"""A run under way as plain arrays: all that is needed to continue it exactly.

A Box2D world cannot be saved, but an episode is its reset seed and its actions: the walker is
brought back by playing them again.
"""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hitl_jax.envs import WalkerPool
from hitl_jax.envs.episode_log import playback
from hitl_jax.errors import ResultsError
from hitl_jax.learner.frame import Layout
from hitl_jax.results import recorded_episodes
from hitl_jax.results.run_key import RunKey
from hitl_jax.training.run_spec import Divergence, Run, RunSpec, Snapshot
from hitl_jax.types import Behavior

_ANEW = "remove under_way from the results to begin its runs anew"


class SavedRun(NamedTuple):
    """A run between two chunks.

    Attributes:
        facts: what JSON can hold: its name, counters, and a row for each ended episode.
        train: training state, packed, uint32 [P].
        acting: acting state, packed, uint32 [S].
        behavior: what acting will need of the parameters in the coming chunks, one after the other,
            packed, [LAG + 1, B].
        snapshots: what acting needed at each snapshot, packed, [K, B].
        boundaries: the boundary source's carry at each snapshot, [K] or [K, C].
        observation: s_t, [O].
        steps: of the episode under way, [T, A + 13]; see `hitl_jax.training.step_booking`.
        recordings: steps of the recorded episodes, one after the other, [T, A + 5]; see
            `hitl_jax.results.recorded_episodes`.
        frames: for the replay, newest last, [F, W]: those since the run was saved before, or all
            that are still needed.
    """

    facts: dict[str, Any]
    train: np.ndarray
    acting: np.ndarray
    behavior: np.ndarray
    snapshots: np.ndarray
    boundaries: np.ndarray
    observation: np.ndarray
    steps: np.ndarray
    recordings: np.ndarray
    frames: np.ndarray

    @property
    def key(self) -> RunKey:
        """Its name."""
        return RunKey(*(self.facts[name] for name in ("method", "seed", "setting")))

    def without_new_frames(self) -> "SavedRun":
        """To be saved again as it is."""
        return self._replace(frames=np.zeros((0, *self.frames.shape[1:]), self.frames.dtype))


class CannotReturn(ResultsError):
    """A run cannot go on where it was saved; one line."""


def bring_back(
    pool: WalkerPool,
    seeds: np.ndarray,
    episodes: Mapping[int, np.ndarray],
    expected: np.ndarray,
) -> None:
    """Plays unfinished episodes again, so that their walkers stand where they stood.

    Args:
        pool: seedable; its other walkers stay idle.
        seeds: reset seeds, uint32 [N].
        episodes: the actions so far, [T, A], by walker.
        expected: what each walker saw last, [N, O].

    Raises:
        CannotReturn: if a walker sees something else now: another version of the simulation.
    """
    if not episodes:
        return
    for command, action in playback(pool.num_walkers, episodes):
        observation = pool.step(command, action, seeds).observation
    walkers = sorted(episodes)
    changed = [
        w for w in walkers if not np.array_equal(observation[w], expected[w], equal_nan=True)
    ]
    if changed:
        raise CannotReturn(
            f"{len(changed)} of {len(walkers)} walkers did not come back as they were (was the "
            f"sweep begun with another version of Box2D or gymnasium?); {_ANEW}"
        )


def facts_of(run: Run, begun: bool) -> dict[str, Any]:
    """What JSON can hold of a run; `begun` says whether an episode is under way."""
    return {
        **dataclasses.asdict(run.spec.key),
        "ticks": run.ticks,
        "env_steps": run.env_steps,
        "updates": run.updates,
        "seconds": time.monotonic() - run.started,
        "begun": bool(begun),
        "diverged": run.diverged,
        "snapshots": [snapshot.episode for snapshot in run.snapshots],
        "recordings": recorded_episodes.index(run.recordings),
        "episodes": list(run.episodes),
        "diagnostics": list(run.diagnostics),
    }


def restore_record(run: Run, saved: SavedRun, behaviors: Sequence[Behavior]) -> None:
    """Gives a run the record that it had when it was saved: episodes, counters, snapshots.

    Args:
        run: at its beginning; changed.
        saved: the run as it was.
        behaviors: what acting needed at each of its snapshots.
    """
    facts = saved.facts
    run.episodes = list(facts["episodes"])
    run.diagnostics = list(facts["diagnostics"])
    run.ticks, run.env_steps, run.updates = (
        facts[name] for name in ("ticks", "env_steps", "updates")
    )
    run.started -= facts["seconds"]
    run.diverged = Divergence(*facts["diverged"]) if facts["diverged"] else None
    kept = _kept_at(run.spec, facts, len(saved.snapshots))
    run.snapshots = [Snapshot(*one) for one in zip(kept, behaviors, saved.boundaries, strict=True)]
    # A program that keeps others may have saved it: what is past cannot be kept any more.
    ahead = [point for point in run.spec.snapshots if point > len(run.episodes)]
    run.spec = dataclasses.replace(run.spec, snapshots=(*kept, *ahead))
    run.recordings = recorded_episodes.split(facts["recordings"], saved.recordings)
    run.done = len(run.episodes) >= run.spec.episodes or run.diverged is not None


def _kept_at(spec: RunSpec, facts: Mapping[str, Any], count: int) -> tuple[int, ...]:
    """Training episodes at which a run's snapshots were kept."""
    if "snapshots" in facts:
        return tuple(facts["snapshots"])
    # Saves that do not tell are of programs that kept them at the fifths of training.
    points = {spec.episodes * part // 5 for part in range(1, 5)} - {0}
    return tuple(sorted(points))[:count]


def between_episodes(saved: SavedRun, layout: Layout) -> SavedRun:
    """The run at the end of its last episode: the walker of the next cannot be brought back.

    The steps that it took stay in the replay, as of an episode that was cut off, and so do those of
    the times before that the run was taken up.
    """
    frames = saved.frames.copy()
    stepped = frames[:, layout.final] == 0
    open_end = stepped & (frames[:, layout.terminated] == 0) & (frames[:, layout.truncated] == 0)
    frames[open_end & ~np.append(stepped[1:], False), layout.truncated] = 1.0
    return saved._replace(
        facts=saved.facts | {"begun": False},
        frames=frames,
        steps=saved.steps[:0],
    )


def cannot_return(key: RunKey, error: Exception) -> CannotReturn:
    """What is said of a run that does not fit; of an error that says so already, that."""
    if isinstance(error, CannotReturn):
        return error
    return CannotReturn(f"{key} was saved by another program; {_ANEW}")


def require_shapes(saved: SavedRun, expected: Mapping[str, tuple[int, ...]]) -> None:
    """Refuses a run whose arrays are not as they must be.

    Args:
        saved: the run.
        expected: shapes by field.

    Raises:
        CannotReturn: if another program, or one of other options, has saved it.
    """
    if any(getattr(saved, name).shape != shape for name, shape in expected.items()):
        raise CannotReturn(f"{saved.key} was saved by another program; {_ANEW}")
