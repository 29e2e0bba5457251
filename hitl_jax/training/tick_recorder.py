"""Records what the walkers of a batch did: steps, episodes, and where a run diverged (NumPy)."""

from collections.abc import Iterator

import numpy as np

from hitl_jax.config import AgentConfig
from hitl_jax.envs import WalkerPool
from hitl_jax.envs.base import ends_of
from hitl_jax.envs.episode_log import EpisodeLog
from hitl_jax.learner.frame import Layout, flag_of
from hitl_jax.results.episode_measures import row_of
from hitl_jax.results.recorded_episodes import STEP_COLUMNS, Recording, names_of
from hitl_jax.training.run_spec import Divergence, LoopConfig, Run, episode_seed
from hitl_jax.training.saved_run import SavedRun
from hitl_jax.training.stage import Slots, Tick
from hitl_jax.training.step_booking import (
    end_of_step,
    episode_of,
    finite_decision,
    frames_of,
    recorded_steps,
    write_answer,
)


class TickRecorder:
    """Records the ticks of R slots: ends their episodes, and their runs.

    Attributes:
        slots: what the stage knows of each slot.
        logged: columns of a step as it is kept until its episode has ended.
        recorded_width: columns of a step of a recorded episode.
    """

    def __init__(self, config: AgentConfig, layout: Layout, pool: WalkerPool, loop: LoopConfig):
        """Begins with empty slots.

        Args:
            config: static choices of the team.
            layout: columns of a packed tick.
            pool: one walker a slot.
            loop: the length of a chunk.
        """
        num_slots = pool.num_walkers
        self._config, self._layout, self._chunk = config, layout, loop.chunk
        self._ends = ends_of(pool)
        self.logged = layout.without_observation
        self.recorded_width = pool.action_size + len(STEP_COLUMNS)
        self.slots = Slots(
            active=np.zeros(num_slots, bool),
            needs_reset=np.zeros(num_slots, bool),
            # No two chunks can begin more episodes: one of a step and a reset takes two ticks.
            seeds=np.zeros((num_slots, loop.chunk + 1), np.uint32),
            left=np.zeros(num_slots, np.int32),
            observation=np.zeros((num_slots, pool.observation_size), np.float32),
        )
        self._runs: list[Run | None] = [None] * num_slots
        self._log = EpisodeLog(num_slots, self.logged.step_width)
        self._intervened = np.zeros(num_slots, bool)  # In the episode under way, before this chunk.
        self._weight, self._feedback = np.ones(num_slots), np.zeros(num_slots)
        self._ended: dict[int, Run] = {}

    def begin(self, run: Run) -> None:
        """Gives a run's slot to the run, at its beginning."""
        slot = run.slot
        self._runs[slot] = run
        self._log.begin(slot)
        self._intervened[slot] = False
        self._weight[slot] = run.spec.hyper.reward_weight
        self._feedback[slot] = run.spec.hyper.feedback
        self.slots.active[slot] = True
        self.slots.needs_reset[slot] = True
        self._look_ahead(run)

    def restore(self, run: Run, saved: SavedRun) -> None:
        """Goes on with a run that has begun in its slot, where it was when it was saved."""
        slot = run.slot
        self._log.begin(slot, saved.steps)
        self._intervened[slot] = flag_of(saved.steps, self.logged, "control").any()
        self.slots.active[slot] = not run.done
        self.slots.needs_reset[slot] = not saved.facts["begun"]
        self.slots.observation[slot] = saved.observation
        self._look_ahead(run)

    def end(self, slot: int) -> None:
        """Takes a slot from its run."""
        self._runs[slot] = None

    def runs(self) -> list[Run]:
        """The runs that have a slot."""
        return [run for run in self._runs if run is not None]

    def take_ended(self) -> list[Run]:
        """The runs of which an episode has ended, or that have diverged, since this was asked."""
        ended, self._ended = [*self._ended.values()], {}
        return ended

    def has_slot(self, run: Run) -> bool:
        """Whether a run still has its slot."""
        return self._runs[run.slot] is run

    def unfinished(self, slot: int) -> np.ndarray:
        """The steps so far of the episode under way, [T, A + 13]."""
        return self._log.of(slot)

    def book(self, ticks: Iterator[Tick]) -> np.ndarray:
        """Records a chunk of ticks; gives the frames for the replay, [R, U, W]."""
        layout, slots = self._layout, self.slots
        steps = np.zeros((len(self._runs), self._chunk, layout.step_width), np.float32)
        for place, tick in enumerate(ticks):
            step = steps[:, place]
            step[:] = tick.decided
            live, begins = slots.live, slots.active & slots.needs_reset
            for quantity, finite in finite_decision(step, layout).items():
                self.stop_diverged(quantity, finite | ~live)
            live &= slots.active
            answer = tick.answer(live)
            end = end_of_step(step, answer, layout, live, begins)
            for quantity, finite in end.finite.items():
                self.stop_diverged(quantity, finite)
            write_answer(step, answer, layout)
            self._log.add(live & end.sound, step[:, layout.action.start :])
            slots.needs_reset[:] = False
            slots.observation = answer.observation.copy()
            for slot in end.ended.nonzero()[0].tolist():
                self._end_episode(slot)
        rewards = self._weight, self._feedback
        frames, self._intervened = frames_of(
            steps, layout, self._config, *rewards, self._intervened, self._ends
        )
        for run in self.runs():
            run.ticks += self._chunk
        return frames

    def stop_diverged(self, quantity: str, finite: np.ndarray) -> None:
        """Ends the runs that are active and of which something is not finite.

        Args:
            quantity: what it is.
            finite: whether it is finite, bool [R].
        """
        for slot in np.flatnonzero(self.slots.active & ~finite).tolist():
            run = self._run(slot)
            steps = run.env_steps + self._log.length_of(slot)
            self._ended[slot] = run
            run.diverged = Divergence(quantity, steps, len(run.episodes))
            run.done = True
            self.slots.active[slot] = False

    def _run(self, slot: int) -> Run:
        run = self._runs[slot]
        assert run is not None
        return run

    def _end_episode(self, slot: int) -> None:
        run = self._run(slot)
        self._ended[slot] = run
        steps, hyper = self._log.of(slot), run.spec.hyper
        row = row_of(episode_of(steps, self.logged, self._config, hyper), self._ends)
        run.env_steps += len(steps)
        run.episodes.append({"episode": len(run.episodes) + 1, "env_steps": run.env_steps, **row})
        for name in names_of(run.episodes, run.recordings):
            kept = recorded_steps(steps, self.logged, hyper)
            run.recordings[name] = Recording(len(run.episodes), kept)
        self._log.begin(slot)
        slots, ended = self.slots, len(run.episodes)
        slots.needs_reset[slot] = True
        slots.left[slot] -= 1
        seeds = slots.seeds[slot]
        seeds[:-1] = seeds[1:]
        seeds[-1] = episode_seed(run.spec.method, run.spec.seed, ended + len(seeds) - 1)
        if ended == run.spec.episodes:
            run.done = True
            slots.active[slot] = False

    def _look_ahead(self, run: Run) -> None:
        """Notes how many episodes a run has yet to play, and the seeds of the next ones."""
        spec, slots, ended = run.spec, self.slots, len(run.episodes)
        slots.left[run.slot] = spec.episodes - ended
        slots.seeds[run.slot] = [
            episode_seed(spec.method, spec.seed, ended + later)
            for later in range(slots.seeds.shape[1])
        ]
