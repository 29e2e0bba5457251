"""The examiner whose walkers are on the host: a walker for each episode of one run's policies."""

import functools
from collections.abc import Callable, Sequence

import jax
import numpy as np

from hitl_jax.choices.checks import require_whole
from hitl_jax.config import RunHyper, typed
from hitl_jax.envs import Command, StepBatch, WalkerPool
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
from hitl_jax.training.run_spec import (
    RunSpec,
    Snapshot,
)
from hitl_jax.training.step_booking import (
    complete,
    episode_of,
    finite_answer,
    finite_decision,
    logged_layout,
    step_width,
)
from hitl_jax.types import Behavior
from hitl_jax.xla import full_registers
from hitl_jax.xla.devices import acting_device

Watch = Callable[[np.ndarray, np.ndarray], None]
"""Called before each step of a test with what was decided, a frame and flags of `packed_decision`,
[N, W + 6], and which walkers take the step, bool [N]."""


class Evaluator:
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
        return [
            evaluate_policies(self, t.mode, t.spec, t.policies, lambda *_: between())
            for t in trials
        ]

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
        hyper = typed(frozen(hyper, human_present=mode == "assisted"))
        # Committed to the acting device, the programs run there, a GPU or not.
        placed, params, key = jax.device_put((hyper, params, key), acting_device())
        config, layout = self._agent.config, self._agent.layout
        num_policies, episodes = seeds.shape
        width = full_registers.full(episodes)
        state = _init(self._agent, placed, boundary, key, np.arange(width))
        seen = np.zeros((num_policies, width, layout.observation_size), np.float32)
        live = np.zeros((num_policies, width), bool)
        logged = logged_layout(layout)
        walkers = self._pool.num_walkers
        log = EpisodeLog(walkers, step_width(logged))
        rows: list[Row | None] = [None] * walkers
        active = np.arange(walkers) < seeds.size
        action = np.zeros((walkers, layout.action_size), np.float32)
        decided = np.zeros((walkers, step_width(layout)), np.float32)
        resets = np.zeros(walkers, np.uint32)
        resets[: seeds.size] = seeds.ravel()
        command = np.where(active, Command.RESET, Command.IDLE).astype(np.uint8)

        def without(lost: np.ndarray) -> np.ndarray:
            """Who goes on, bool [N], where some are lost; see `lost_test`."""
            for walker in np.flatnonzero(active & lost).tolist():
                place = {"mode": mode, "episode": walker % seeds.shape[1] + 1}
                rows[walker] = place | lost_test()
            return active & ~lost

        answer = self._pool.step(command, action, resets)
        active = without(_broken(answer))
        while active.any():
            seen[:, :episodes] = answer.observation[: seeds.size].reshape(*seeds.shape, -1)
            live[:, :episodes] = active[: seeds.size].reshape(seeds.shape)
            state, packed = _act(self._agent, placed, params, state, seen, live)
            decided[: seeds.size] = np.asarray(packed)[:, :episodes].reshape(seeds.size, -1)
            # A policy of numbers that are not finite cannot act.
            active = without(~finite_decision(decided, layout))
            if watch is not None:
                watch(decided, active)
            command = np.where(active, Command.STEP, Command.IDLE).astype(np.uint8)
            answer = self._pool.step(command, decided[:, layout.action], resets)
            active = without(_broken(answer))
            ended = active & complete(decided, answer, layout)
            log.add(active, decided[:, layout.action.start :])
            for walker in np.flatnonzero(ended).tolist():
                row = row_of(episode_of(log.of(walker), logged, config, hyper))
                rows[walker] = {"mode": mode, "episode": walker % seeds.shape[1] + 1, **row}
                active[walker] = False
        return [row for row in rows if row is not None]


def _broken(answer: StepBatch) -> np.ndarray:
    """Whose observation or reward is not finite, bool [N]."""
    return ~np.logical_and(*finite_answer(answer).values())


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


def evaluate_policies(
    evaluator: Evaluator,
    mode: Mode,
    spec: RunSpec,
    policies: Sequence[Snapshot],
    watch: Watch | None = None,
) -> list[Row]:
    """One test of some of a run's policies, each on the same terrains.

    Args:
        evaluator: its walkers are shared out among the policies.
        mode: `autonomous` or `assisted`.
        spec: the run.
        policies: at most as many as walkers.
        watch: sees every step.

    Returns:
        A row for each policy and episode.
    """
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *policies)
    seeds = terrain_seeds(spec, evaluator.num_episodes // len(policies))
    everywhere = np.tile(seeds, (len(policies), 1))
    return evaluator.evaluate(
        mode, spec.hyper, stacked.behavior, stacked.boundary, trial_key(spec), everywhere, watch
    )
