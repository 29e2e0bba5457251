"""The examiner whose walkers are on the host: a walker for each episode of one run's policies."""

import functools
from collections.abc import Callable, Sequence

import jax
import numpy as np

from hitl_jax.choices.checks import require_whole
from hitl_jax.config import RunHyper, typed
from hitl_jax.envs import Command, WalkerPool
from hitl_jax.envs.base import ends_of
from hitl_jax.envs.episode_log import EpisodeLog
from hitl_jax.evaluation.trials import (
    Mode,
    Trial,
    as_tested,
    frozen,
    init_test,
    terrain_seeds,
    trial_key,
)
from hitl_jax.results.episode_measures import Row, lost_test, row_of
from hitl_jax.team import packed_decision
from hitl_jax.team.acting import ActingState
from hitl_jax.team.agent import Agent
from hitl_jax.training.step_booking import end_of_step, episode_of, finite_decision, write_answer
from hitl_jax.types import Behavior
from hitl_jax.xla import full_registers
from hitl_jax.xla.devices import acting_device

Watch = Callable[[np.ndarray, np.ndarray], None]
"""Called before each step of a test with what was decided, a frame and flags of `packed_decision`,
[N, W + 6], and which walkers take the step, bool [N]."""


class HostExaminer:
    """An `Examiner` that plays the policies of one run at a time, a walker for each episode.

    Everything is frozen: no exploration, no learning, the boundary as training left it.
    `autonomous`: nobody intervenes; alarms and judgements are recorded all the same. `assisted`:
    arbiter and human are on, and an intervention is a takeover, whatever it was in training, since
    a test is not reset.
    """

    def __init__(self, agent: Agent, pool: WalkerPool):
        """Compiles lazily.

        Args:
            agent: the team as it trained.
            pool: one walker for each episode.
        """
        self._agent = as_tested(agent)
        self._pool = pool
        self.num_episodes = pool.num_walkers
        self.num_runs = 1

    def play(self, trials: Sequence[Trial], between: Callable[[], None]) -> list[list[Row]]:
        """See `Examiner`."""
        return [play_trial(self, trial, lambda *_: between()) for trial in trials]

    def evaluate(
        self,
        mode: Mode,
        hyper: RunHyper,
        params: Behavior,
        boundary: np.ndarray,
        key: jax.Array,
        seeds: np.ndarray,
        watch: Watch | None = None,
    ) -> list[Row]:
        """Plays one episode on each walker, all of K policies of one run.

        Args:
            mode: `autonomous` or `assisted`.
            hyper: the run's hyperparameters, scalars.
            params: trained parameters, leaves [K, ...].
            boundary: the boundary source's carry of each policy, [K] or [K, C].
            key: consumed.
            seeds: reset seeds of each policy's episodes, uint32 [K, E], K · E at most the pool's
                walkers.
            watch: sees every step.

        Returns:
            A row for each episode, policy after policy.

        Raises:
            ValueError: if there is no episode, or no walker for each.
        """
        require_whole("episodes", seeds.size, 1, self._pool.num_walkers)
        test = _Test(self._agent, self._pool, mode, hyper, seeds)
        # Committed to the acting device, the programs run there, a GPU or not.
        placed, params, key = jax.device_put((test.hyper, params, key), acting_device())
        state = _init(self._agent, placed, boundary, key, np.arange(test.width))
        test.begin()
        while test.active.any():
            seen, live = test.seen()
            state, packed = _act(self._agent, placed, params, state, seen, live)
            test.step(np.asarray(packed), watch)
        return test.rows()


class _Test:
    """The walkers of one test: an episode of each of K policies and E terrains.

    Attributes:
        hyper: the run's hyperparameters in a test, typed host scalars.
        width: E, filled up; acting takes so many rows of a policy.
        active: whose episode is under way, bool [N].
    """

    def __init__(
        self, agent: Agent, pool: WalkerPool, mode: Mode, hyper: RunHyper, seeds: np.ndarray
    ):
        self._config, self._layout, self._pool, self._mode = agent.config, agent.layout, pool, mode
        self._ends = ends_of(pool)
        self.hyper = typed(frozen(hyper, human_present=mode == "assisted"))
        self._seeds = seeds
        self.width = full_registers.full(seeds.shape[1])
        walkers = pool.num_walkers
        self.active = np.arange(walkers) < seeds.size
        self._resets = np.zeros(walkers, np.uint32)
        self._resets[: seeds.size] = seeds.ravel()
        self._logged = self._layout.without_observation
        self._log = EpisodeLog(walkers, self._logged.step_width)
        self._decided = np.zeros((walkers, self._layout.step_width), np.float32)
        self._rows: list[Row | None] = [None] * walkers

    def begin(self) -> None:
        """Resets the walkers."""
        idle = np.zeros_like(self.active)
        command = np.where(self.active, Command.RESET, Command.IDLE).astype(np.uint8)
        action = np.zeros((len(idle), self._layout.action_size), np.float32)
        answer = self._pool.step(command, action, self._resets)
        self._lose(~end_of_step(self._decided, answer, self._layout, idle, self.active).sound)
        self._observation = answer.observation

    def seen(self) -> tuple[np.ndarray, np.ndarray]:
        """What each policy's walkers see, [K, width, O], and who takes a step, bool [K, width]."""
        policies, episodes = self._seeds.shape
        seen = np.zeros((policies, self.width, self._layout.observation_size), np.float32)
        live = np.zeros((policies, self.width), bool)
        own = self._seeds.size
        seen[:, :episodes] = self._observation[:own].reshape(policies, episodes, -1)
        live[:, :episodes] = self.active[:own].reshape(policies, episodes)
        return seen, live

    def step(self, packed: np.ndarray, watch: Watch | None) -> None:
        """Plays a step of all episodes under way.

        Args:
            packed: what acting decided, [K, width, W + 6].
            watch: sees the step before it is played.
        """
        layout, decided, own = self._layout, self._decided, self._seeds.size
        decided[:own] = packed[:, : self._seeds.shape[1]].reshape(own, -1)
        for finite in finite_decision(decided, layout).values():
            self._lose(~finite)
        if watch is not None:
            watch(decided, self.active)
        command = np.where(self.active, Command.STEP, Command.IDLE).astype(np.uint8)
        answer = self._pool.step(command, decided[:, layout.action], self._resets)
        end = end_of_step(decided, answer, layout, self.active, np.zeros_like(self.active))
        self._lose(~end.sound)
        write_answer(decided, answer, layout)
        self._log.add(self.active, decided[:, layout.action.start :])
        for walker in np.flatnonzero(end.ended).tolist():
            steps = self._log.of(walker)
            self._end(
                walker,
                row_of(episode_of(steps, self._logged, self._config, self.hyper), self._ends),
            )
        self._observation = answer.observation

    def rows(self) -> list[Row]:
        """A row for each episode, policy after policy."""
        return [row for row in self._rows if row is not None]

    def _lose(self, lost: np.ndarray) -> None:
        """Ends the episodes under way in which something is not finite; see `lost_test`."""
        for walker in np.flatnonzero(self.active & lost).tolist():
            self._end(walker, lost_test())

    def _end(self, walker: int, row: Row) -> None:
        number = walker % self._seeds.shape[1] + 1
        self._rows[walker] = {"mode": self._mode, "episode": number, **row}
        self.active[walker] = False


@functools.partial(jax.jit, static_argnums=0)
def _init(
    agent: Agent, hyper: RunHyper, boundary: jax.Array, key: jax.Array, episodes: jax.Array
) -> ActingState:
    """Acting states, leaves [K, E, ...]."""
    one = functools.partial(init_test, agent, hyper)
    policies = jax.vmap(one, in_axes=(None, None, 0))
    return jax.vmap(policies, in_axes=(0, None, None))(boundary, key, episodes)


@functools.partial(jax.jit, static_argnums=0)
def _act(
    agent: Agent,
    hyper: RunHyper,
    params: Behavior,
    state: ActingState,
    observation: jax.Array,
    live: jax.Array,
) -> tuple[ActingState, jax.Array]:
    """A step of E episodes with each of K policies, leaves [K, E, ...]."""
    step = functools.partial(packed_decision.act_or_begin, agent)
    episodes = jax.vmap(step, in_axes=(None, None, 0, 0, 0))
    everything = jax.vmap(episodes, in_axes=(None, 0, 0, 0, 0))
    return everything(hyper, params, state, observation, live)


def play_trial(examiner: HostExaminer, trial: Trial, watch: Watch | None = None) -> list[Row]:
    """Plays a test of some of a run's policies, each on the same terrains.

    Args:
        examiner: has a walker for each policy and episode.
        trial: the test.
        watch: sees every step.

    Returns:
        A row for each policy and episode, policy after policy.
    """
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *trial.policies)
    seeds = np.tile(terrain_seeds(trial.spec, range(trial.episodes)), (len(trial.policies), 1))
    key = trial_key(trial.spec)
    return examiner.evaluate(
        trial.mode, trial.spec.hyper, stacked.behavior, stacked.boundary, key, seeds, watch
    )
