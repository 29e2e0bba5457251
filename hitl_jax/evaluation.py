"""The test phase (Fig. 5): a trained walker over many episodes, noise off, alone and helped."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, Protocol

import jax
import numpy as np

from hitl_jax import batch, decisions, lanes
from hitl_jax.acting import ActingState, init_acting
from hitl_jax.agent import Agent, behavior
from hitl_jax.config import Method, RunHyper, require_whole, typed
from hitl_jax.devices import acting_device
from hitl_jax.envs import Command, StepBatch, WalkerPool
from hitl_jax.episode_log import EpisodeLog
from hitl_jax.episodes import Row, fall_at_once, lost_test, row_of
from hitl_jax.runs import FinishedRun, Run, RunSpec, Snapshot, episode_seed, method_index
from hitl_jax.steps import (
    complete,
    episode_of,
    finite_answer,
    finite_decision,
    logged_layout,
    step_width,
)
from hitl_jax.types import Behavior

Mode = Literal["autonomous", "assisted"]

Watch = Callable[[np.ndarray, np.ndarray], None]
"""Called before each step of a test with what was decided, a frame and flags of `decisions`,
[N, W + 6], and which walkers take the step, bool [N]."""

MOST_TEST_EPISODES = 10_000
"""Of one test: the host's examiner has a walker for each."""

_PARTS = 5
_TESTS = 3
"""Of a run at most: alone, assisted, and its snapshots."""


class Trial(NamedTuple):
    """A test of some of a run's policies, each on the same terrains.

    Attributes:
        mode: `autonomous` or `assisted`.
        spec: the run.
        policies: to be tested, K.
        episodes: of each policy.
    """

    mode: Mode
    spec: RunSpec
    policies: Sequence[Snapshot]
    episodes: int


class Examiner(Protocol):
    """Plays trials.

    Attributes:
        num_episodes: of one test.
        num_runs: how many it likes to be given at a time, for the sake of speed.
    """

    num_episodes: int
    num_runs: int

    def play(self, trials: Sequence[Trial], between: Callable[[], None]) -> list[list[Row]]:
        """Plays trials.

        Args:
            trials: of any runs.
            between: called every now and then; may raise to break off.

        Returns:
            Of each trial a row for each policy and episode, policy after policy.
        """
        ...


def milestones(episodes: int) -> tuple[int, ...]:
    """Numbers of training episodes at which a run is tested before its end: its fifths."""
    points = (episodes * part // _PARTS for part in range(1, _PARTS))
    return tuple(sorted({point for point in points if point > 0}))


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
        width = lanes.full(episodes)
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


def num_test_walkers(backend: str, episodes: int, num_runs: int, num_devices: int) -> int:
    """Walkers for the tests of a batch of runs.

    Args:
        backend: of the walkers.
        episodes: of one test.
        num_runs: how many runs will be tested.
        num_devices: CPU devices that backend `jax` shares its walkers out over.
    """
    if backend != "jax":
        return episodes
    from hitl_jax.device_evaluation import num_walkers  # Which imports this module.

    return num_walkers(_TESTS * num_runs * episodes, num_devices)


def make_examiner(agent: Agent, pool: WalkerPool, episodes: int) -> Examiner:
    """The device's examiner for walkers that are on one, else the host's.

    Args:
        agent: the team as it trained.
        pool: of `num_test_walkers`.
        episodes: of one test.
    """
    if hasattr(pool, "blocks"):  # Of a JaxPool.
        from hitl_jax.device_evaluation import DeviceEvaluator

        return DeviceEvaluator(agent, pool, episodes)  # type: ignore[arg-type]
    return Evaluator(agent, pool)


def as_tested(agent: Agent) -> Agent:
    """The team in a test, where no intervention is a reset."""
    return agent._replace(config=dataclasses.replace(agent.config, intervention="takeover"))


def init_test(
    agent: Agent, hyper: RunHyper, boundary: jax.Array, key: jax.Array, episode: jax.Array
) -> ActingState:
    """Acting at the first step of a test episode; its key depends on nothing else.

    Args:
        agent: the team.
        hyper: scalars.
        boundary: the boundary source's carry, [] or [C].
        key: of the run's tests, [].
        episode: its number from 0 on, [].
    """
    state = init_acting(agent, hyper, jax.random.fold_in(key, episode))
    return dataclasses.replace(state, boundary=boundary)


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
    step = functools.partial(decisions.act_or_begin, agent)
    episodes = jax.vmap(step, in_axes=(None, None, 0, 0, 0))
    everything = jax.vmap(episodes, in_axes=(None, 0, 0, 0, 0))
    return everything(hyper, params, state, observation, live)


def evaluate_runs(
    examiner: Examiner,
    runs: Sequence[FinishedRun],
    modes: Callable[[Method], Sequence[Mode]],
    between: Callable[[], None] = lambda: None,
) -> list[tuple[list[Row], list[Row]]]:
    """Tests runs as training left them, and, alone, as they were at their snapshots.

    The terrain depends on the seed alone: a comparison that is paired over methods needs fewer
    episodes. Of N episodes of a test each of K snapshots gets ⌊N / K⌋, at least one, on the first
    terrains of the test at the end. A run that diverged counts as falling at once.

    Args:
        examiner: plays the episodes.
        runs: that have ended.
        modes: which tests at the end, in this order, by method.
        between: see `Examiner.play`.

    Returns:
        Of each run a row for each mode and episode; and one for each snapshot and episode, with
        the number of training episodes as `trained`.
    """
    each = examiner.num_episodes
    final = [_final(run, modes(run.run.spec.method), each) for run in runs]
    earlier = [_earlier(run.run, each) for run in runs]
    asked = [trial for trials in [*final, *earlier] for trial in trials]
    played = iter(examiner.play(asked, between))
    at_end = [[row for _ in trials for row in next(played)] for trials in final]
    on_the_way = [
        [row for trial in trials for row in _told(run.run, trial, next(played))]
        for run, trials in zip(runs, earlier, strict=True)
    ]
    return list(zip(at_end, on_the_way, strict=True))


def _final(finished: FinishedRun, modes: Sequence[Mode], episodes: int) -> list[Trial]:
    """The tests of a run as training left it."""
    spec = finished.run.spec
    last = Snapshot(spec.episodes, behavior(finished.train), finished.boundary)
    return [Trial(mode, spec, [last], episodes) for mode in modes]


def _earlier(run: Run, episodes: int) -> list[Trial]:
    """The tests of a run's snapshots, which share the episodes of a test."""
    groups = (
        run.snapshots[first : first + episodes] for first in range(0, len(run.snapshots), episodes)
    )
    return [Trial("autonomous", run.spec, group, episodes // len(group)) for group in groups]


def _told(run: Run, trial: Trial, rows: Sequence[Row]) -> list[Row]:
    """Rows of a test of snapshots, with what tells them apart."""
    lost = run.diverged.episodes if run.diverged else run.spec.episodes
    told = []
    for number, row in enumerate(rows):
        trained = trial.policies[number // trial.episodes].episode
        told.append({"trained": trained, **row} | (fall_at_once() if trained > lost else {}))
    return told


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


def terrain_seeds(spec: RunSpec, episodes: int) -> np.ndarray:
    """Reset seeds of a run's test episodes, the same for all methods, uint32 [E]."""
    seeds = [episode_seed("test", spec.seed, number) for number in range(episodes)]
    return np.array(seeds, np.uint32)


def trial_key(spec: RunSpec) -> jax.Array:
    """The key of a run's tests, []."""
    *_, key = batch.run_keys(spec.seed, method_index(spec.method))
    return key


def frozen(hyper: RunHyper, human_present: bool) -> RunHyper:
    """The hyperparameters of a test: no exploration, no feedback, no movement of the boundary."""
    return dataclasses.replace(
        hyper,
        human_present=float(human_present),
        feedback=0.0,
        exploration_noise=0.0,
        boundary_noise=0.0,
        warmup_steps=0,
        delta_minus=0.0,
        delta_plus=0.0,
    )
