"""The host loop: it plays walkers while the learner updates in parallel.

Time is cut into ticks (one step of every walker) and chunks of U ticks. While the walkers play
chunk i+1, the device learns from chunk i, or still from chunk i−1: up to `learner_queue.LAG` calls
of the learner are under way, so that neither side waits for the other at the end of a chunk. The
parameters that act in chunk i+1 are those learned up to chunk i−`LAG`. The lag is part of a run's
definition: it is the same whatever the machine's speed. (Where walkers and learner are on one GPU,
a call is made with a chunk, and the host books a chunk while the next is played.)

A slot is a column of the batch. Runs wait in a queue for a slot; a run that is done leaves its slot
at once, and takes no more time. Nothing a run computes depends on its slot or on its neighbours.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hitl_jax.config import typed
from hitl_jax.envs import WalkerPool
from hitl_jax.envs.base import require_sizes
from hitl_jax.results import recorded_episodes
from hitl_jax.results.episode_measures import Row
from hitl_jax.results.run_key import RunKey
from hitl_jax.team.agent import Agent, require_extra
from hitl_jax.team.diagnostics import EVERY, on_host
from hitl_jax.team.warmup import may_learn
from hitl_jax.training import batch_arrays
from hitl_jax.training.late_notes import LateNotes
from hitl_jax.training.learner_queue import LearnerQueue
from hitl_jax.training.run_spec import (
    FinishedRun,
    LoopConfig,
    Run,
    RunSpec,
    method_index,
)
from hitl_jax.training.saved_run import (
    SavedRun,
    between_episodes,
    bring_back,
    cannot_return,
    facts_of,
    require_shapes,
    restore_record,
)
from hitl_jax.training.stage import Tick
from hitl_jax.training.stage_for_pool import make_stage
from hitl_jax.training.tick_recorder import TickRecorder
from hitl_jax.xla.devices import learning_devices


class _Chunk(NamedTuple):
    """Ticks that are played, or will be as they are asked for.

    Attributes:
        parameters: what acts in it, of each learning device's runs.
        ticks: one after the other.
    """

    parameters: list[batch_arrays.PackedBehavior]
    ticks: Iterator[Tick]


class Rollout:
    """Plays and trains a list of runs over a fixed number of slots."""

    def __init__(
        self,
        agent: Agent,
        specs: Sequence[RunSpec],
        pool: WalkerPool,
        config: LoopConfig,
        saved: dict[RunKey, SavedRun] | None = None,
    ):
        """Places everything on the devices.

        Args:
            agent: the team.
            specs: the runs; more than `pool.num_walkers` wait for a slot.
            pool: one walker a slot; the number of slots must be a multiple of the devices'.
            config: how much to play and learn.
            saved: runs to go on with, each taken out when it has a slot, since its replay is large;
                None says that none will be saved either.

        Raises:
            CannotReturn: if a saved run's walker does not come back as it was.
        """
        self._agent = agent
        self._pool = pool
        self._config = config
        self._layout = agent.layout
        slots = pool.num_walkers
        _check(agent, pool, config)
        self._saved = {} if saved is None else saved
        longest = max((len(run.frames) for run in self._saved.values()), default=0)
        self._learner = LearnerQueue(agent, config, slots, longest)
        self._stage = make_stage(agent, pool, self._learner)
        self._acting_shape = self._stage.words().shape[1:]
        self._saves = saved is not None
        self._recorder = TickRecorder(agent.config, agent.layout, pool, config)
        self._recent = [np.zeros((slots, 0, self._layout.width), np.float32)]
        self._unsaved = np.zeros(slots, int)  # Frames since a run got its slot, or was saved.
        self._queue = deque(sorted(specs, key=lambda spec: spec.key not in self._saved))
        self._held: set[RunKey] = set()
        self._ahead: _Chunk | None = None
        self._notes = LateNotes(self._learner, slots)
        self._fill(self._learner.order())

    def __iter__(self) -> Iterator[list[FinishedRun]]:
        """Plays chunk after chunk; gives the runs that finished in each.

        A run that had ended when it was saved is given at once. Ends when no run is left but those
        held.
        """
        while under_way := self._not_held(self.runs()):
            ended = [self.collect(run) for run in under_way if run.done]
            ended = ended or self._next_chunk()
            yield ended
            self._replace(self._not_held([finished.run for finished in ended]))

    def runs(self) -> list[Run]:
        """The runs under way, and those that have just been given as finished."""
        return self._recorder.runs()

    def hold(self, ended: Sequence[FinishedRun]) -> None:
        """Lets runs that were given keep their slots, so that they are saved, until `release`."""
        self._held |= {finished.run.spec.key for finished in ended}

    def release(self, ended: Sequence[FinishedRun]) -> None:
        """Gives the slots of runs that were held to others."""
        self._replace([finished.run for finished in ended])
        self._held -= {finished.run.spec.key for finished in ended}

    def waits(self) -> bool:
        """Whether runs that are held keep others from going on, or none is left that would."""
        return bool(self._queue) or not any(not run.done for run in self.runs())

    def collect(self, run: Run) -> FinishedRun:
        """What a run has become so far; for a run that has a slot."""
        self._notes.note(wait=True)
        return FinishedRun(run, self._learner.train_of(run.slot), self._boundary_of(run))

    def diagnose(self, run: Run) -> Row:
        """Losses, values and gradients of a run's learners now, see `team.diagnostics`; waits.

        Args:
            run: one that has a slot, and has played so long that it may learn.
        """
        [(_, metrics)] = self._learner.diagnose([run.slot])
        [measured] = on_host(metrics, 1)
        return run.counters() | measured

    def save(self) -> list[SavedRun]:
        """The runs that are under way, have just ended, or were saved and wait for a slot.

        Between two chunks; waits for the learner; only with `saved` given at the start. The frames
        are those since the runs were saved before.
        """
        self._catch_up()
        self._notes.note(wait=True)
        train, learned = self._learner.save()
        acting = self._stage.words()
        recent = np.concatenate(self._recent, axis=1)
        saved = [run.without_new_frames() for run in self._saved.values()]
        for run in self.runs():
            saved.append(
                SavedRun(
                    facts=facts_of(run, begun=not self._recorder.slots.needs_reset[run.slot]),
                    train=train[run.slot],
                    acting=acting[run.slot],
                    behavior=learned[run.slot],
                    snapshots=np.array(
                        [batch_arrays.flat_behavior(kept.behavior) for kept in run.snapshots]
                    ),
                    boundaries=np.array([kept.boundary for kept in run.snapshots]),
                    observation=self._recorder.slots.observation[run.slot].copy(),
                    steps=self._recorder.unfinished(run.slot),
                    recordings=recorded_episodes.join(
                        run.recordings, self._recorder.recorded_width
                    ),
                    frames=recent[run.slot, max(recent.shape[1] - self._unsaved[run.slot], 0) :],
                )
            )
        self._recent = [recent[:, :0].copy()]
        self._unsaved[:] = 0
        return saved

    def wait(self) -> None:
        """Returns when the learner has nothing left to do."""
        self._learner.wait()

    def _next_chunk(self) -> list[FinishedRun]:
        """Plays a chunk, and gives the runs that ended in it."""
        chunk, self._ahead = self._ahead or self._begin_chunk(), None
        if self._stage.runs_ahead:
            self._ahead = self._begin_chunk()
        return self._book(chunk)

    def _catch_up(self) -> None:
        """Books the chunk that was begun ahead, if there is one.

        Runs that end in it are found when the next chunk would be played.
        """
        if self._ahead is not None:
            chunk, self._ahead = self._ahead, None
            self._book(chunk)

    def _begin_chunk(self) -> _Chunk:
        parameters = self._learner.parameters()
        self._stage.prepare(parameters)
        return _Chunk(parameters, self._stage.ticks(self._recorder.slots, self._config.chunk))

    def _book(self, chunk: _Chunk) -> list[FinishedRun]:
        """Notes what the walkers did, and has the learner learn from it."""
        finite = np.concatenate([np.asarray(part.finite) for part in chunk.parameters])
        self._recorder.stop_diverged("parameters", finite)
        frames = self._recorder.book(chunk.ticks)
        self._unsaved += self._config.chunk
        if self._saves:
            self._recent.append(frames)
            if len(self._recent) > self._config.frames // self._config.chunk:
                del self._recent[0]  # The replay has forgotten it.
        for run in self._recorder.take_ended():
            self._notes.ask_snapshots(run, self._boundary_of)
        ended = [self.collect(run) for run in self._not_held(self.runs()) if run.done]
        self._learn(frames)
        return ended

    def _not_held(self, runs: Sequence[Run]) -> list[Run]:
        if not self._held:
            return list(runs)
        return [run for run in runs if run.spec.key not in self._held]

    def _replace(self, ended: Sequence[Run]) -> None:
        """Gives the slots of runs that have ended, and still have them, to others."""
        slots = [run.slot for run in ended if self._recorder.has_slot(run)]
        if slots and self._queue:
            self._catch_up()
        for slot in slots:
            self._recorder.end(slot)
        self._fill(slots)

    def _fill(self, slots: Sequence[int]) -> None:
        """Gives slots to the next runs in the queue; saved ones go on where they were."""
        recorder = self._recorder
        back: dict[int, np.ndarray] = {}
        for slot in slots:
            if not self._queue:
                break
            spec = self._queue.popleft()
            run = self._begin_run(slot, spec)
            saved = self._saved.pop(spec.key, None)
            if saved is not None:
                try:
                    self._restore_run(run, saved)
                except (ValueError, TypeError, IndexError) as error:
                    raise cannot_return(spec.key, error) from error
                if recorder.slots.live[slot]:
                    back[slot] = saved.steps[:, recorder.logged.action]
        try:
            bring_back(self._pool, recorder.slots.seeds[:, 0], back, recorder.slots.observation)
        except ValueError as error:  # Of actions that no run takes.
            raise cannot_return(spec.key, error) from error

    def _begin_run(self, slot: int, spec: RunSpec) -> Run:
        """Gives a slot to a run at its beginning."""
        learning, acting, _ = batch_arrays.run_keys(spec.seed, method_index(spec.method))
        require_extra(self._agent, spec.hyper)
        hyper = typed(self._agent.with_extra(spec.hyper))
        self._learner.begin(slot, hyper, learning)
        self._stage.begin_run(slot, hyper, acting)
        self._unsaved[slot] = 0
        run = Run(spec=spec, slot=slot)
        self._recorder.begin(run)
        return run

    def _restore_run(self, run: Run, saved: SavedRun) -> None:
        """Makes of a run that has begun what it was when it was saved, but for its walker."""
        self._check_fit(saved, run.spec)
        if not self._pool.seedable:
            saved = between_episodes(saved, self._layout)
        self._learner.restore(run.slot, saved.train, saved.behavior, saved.frames)
        self._stage.restore(run.slot, saved.acting)
        restore_record(run, saved, self._learner.behaviors(saved.snapshots))
        self._recorder.restore(run, saved)

    def _check_fit(self, saved: SavedRun, spec: RunSpec) -> None:
        """Raises CannotReturn unless the arrays are as this agent's are."""
        shapes = self._learner.shapes()
        expected = {
            **shapes,
            "acting": self._acting_shape,
            "observation": (self._layout.observation_size,),
            "frames": (len(saved.frames), self._layout.width),
            "steps": (len(saved.steps), self._recorder.logged.step_width),
            "recordings": (len(saved.recordings), self._recorder.recorded_width),
            "snapshots": (
                min(len(saved.snapshots), len(spec.snapshots)),
                *shapes["behavior"][1:] * bool(len(saved.snapshots)),
            ),
        }
        require_shapes(saved, expected)

    def _boundary_of(self, run: Run) -> np.ndarray:
        return self._stage.boundaries()[run.slot]

    def _learn(self, frames: np.ndarray) -> None:
        """Starts the learner on a chunk; does not wait for it."""
        chunk, n_step = self._config.chunk, self._agent.config.n_step
        learning = {
            run.slot: run
            for run in self.runs()
            if not run.done and (run.updates or may_learn(run.spec.hyper, run.ticks, chunk, n_step))
        }
        for run in learning.values():
            run.updates += self._learner.num_updates
        self._notes.ask_diagnostics()
        self._learner.learn(frames, list(learning))
        self._notes.note(wait=False)
        num_updates = self._learner.num_updates
        self._notes.diagnose_later(
            [run for run in learning.values() if run.updates % EVERY < num_updates]
        )


def _check(agent: Agent, pool: WalkerPool, config: LoopConfig) -> None:
    """Raises ValueError where agent, pool and loop do not fit each other."""
    require_sizes(pool, agent.config.observation_size, agent.config.action_size)
    config.require_n_step(agent.config.n_step)
    config.require_frames(agent.boundary_learner.least_frames, agent.config.boundary_learner)
    devices = len(learning_devices())
    if pool.num_walkers % devices:
        raise ValueError(f"{pool.num_walkers} walkers do not divide over {devices} devices")
